"""Hostile bags: metadata that names other files, wrong lengths, truncated messages, journals that name nothing."""

import contextlib
import io
import json
import struct
import tempfile
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from hypothesis import strategies as st
from numpy.typing import NDArray
from rosbags.rosbag2 import Reader
from ruamel.yaml import YAML

from helpers.fuzz.child import OUTSIDE, Input, Ready
from helpers.fuzz.mutations import (
    HUGE,
    ODD_FLOATS,
    Draw,
    chance,
    mutation,
    odd_count,
    odd_value,
    of_array,
    of_bytes,
    of_text,
    some,
)
from helpers.fuzz.zips import bomb, members, of_zip, packed
from helpers.paths import ROOT
from tissue_sim.ros.bags import metadata, recovery
from tissue_sim.ros.bags.outcome import Asked, replay_bag
from tissue_sim.ros.bags.writer import BagWriter, Topic
from tissue_sim.ros.shared.cdr import parse_octets, parse_text

BAG = "bag"
NAME = "bag_0.mcap"
_SOURCE = ROOT / "bags" / "bad_input"
_ASKED = Asked(force_tolerance=1e-6, position_tolerance=1e-6)

Files = dict[str, bytes | None]
Messages = list[tuple[str, int, bytes]]  # topic, stamp in ns, bytes


def prepare(path: Path) -> Ready:
    """Replay the intact bag."""
    _use_intact()
    return lambda: _use(path)


@cache
def _use_intact() -> None:
    path = Path(tempfile.gettempdir()) / BAG
    path.mkdir()
    for name, data in _files().items():
        (path / name).write_bytes(data)
    _use(path)


def _use(path: Path) -> str:
    """Do what `tissue_sim replay` does: complete, read, replay, compare."""
    with contextlib.redirect_stdout(io.StringIO()):
        if recovery.is_interrupted(path):
            recovery.complete(path)
        outcome = replay_bag(path, _ASKED)
    shown = outcome.replayed.shown
    finite = all(bool(np.isfinite(np.asarray(values)).all()) for values in (*shown.wrenches, *shown.surfaces))
    assert finite, "a replay that shows numbers that are not finite"
    return f"{outcome.replayed.ticks} ticks: {'repeats' if outcome.comparison.passes else 'differs'}"


@st.composite
def bags(draw: Draw) -> Input:
    """Bags with one or more mutations, one in ten without its metadata, as if interrupted."""
    files = mutation(draw, _MUTATIONS)(draw)
    if not isinstance(files, dict):
        return Input({BAG: files}, BAG, prepare)  # a file in place of a bag
    if chance(draw, 10) and files.get(metadata.NAME) is not None:
        del files[metadata.NAME]
    return Input({BAG: None, **{f"{BAG}/{name}": data for name, data in files.items()}}, BAG, prepare)


# a whole bag --------------------------------------------------------------------------------------


@cache
def _content() -> tuple[dict[str, Topic], Messages]:
    """Topics and messages of a short recording."""
    with Reader(_SOURCE) as reader:
        topics = {topic.topic: Topic(topic.msgtype, metadata.qos_of(topic)) for topic in reader.connections}
        return topics, [(topic.topic, stamp, bytes(raw)) for topic, stamp, raw in reader.messages()]


def _written(messages: Messages) -> Files:
    with tempfile.TemporaryDirectory() as folder:
        writer = BagWriter(Path(folder) / BAG)
        writer.open()
        added = writer.add_topics(_content()[0])
        for name, stamp, raw in messages:
            writer.write(added[name], stamp, raw)
        writer.close()
        return {path.name: path.read_bytes() for path in sorted((Path(folder) / BAG).iterdir())}


@cache
def _files() -> dict[str, bytes]:
    return _written(_content()[1])


# files --------------------------------------------------------------------------------------------


def _bytes(draw: Draw) -> Files:
    return _files() | {NAME: of_bytes(draw, _files()[NAME])}


def _records(draw: Draw) -> Files:
    """Change records of the MCAP file: wrong lengths, opcodes and fields, some left out or duplicated."""
    data = bytearray(_files()[NAME])
    for _ in range(draw(st.integers(1, 2))):
        if places := list(_record_places(data)):
            at, length = some(draw, places)
            mutation(draw, (_record_field, _record_field, _record_length, _record_kind, _record_out, _record_twice))(
                draw, data, at, length
            )
    return _files() | {NAME: bytes(data)}


def _record_places(data: bytes | bytearray) -> Iterator[tuple[int, int]]:
    """Where records begin, and their lengths; those of a summary as likely as chunks."""
    at = len(recovery.MAGIC)
    while at + 9 <= len(data):
        length = struct.unpack_from("<Q", data, at + 1)[0]
        if at + 9 + length > len(data):
            break
        yield at, length
        at += 9 + length


def _record_length(draw: Draw, data: bytearray, at: int, length: int) -> None:
    struct.pack_into("<Q", data, at + 1, odd_count(draw, length) % 2**64)


def _record_kind(draw: Draw, data: bytearray, at: int, _length: int) -> None:
    data[at] = draw(st.integers(0, 19))


def _record_out(_draw: Draw, data: bytearray, at: int, length: int) -> None:
    del data[at : at + 9 + length]


def _record_twice(_draw: Draw, data: bytearray, at: int, length: int) -> None:
    data[at:at] = data[at : at + 9 + length]


def _record_field(draw: Draw, data: bytearray, at: int, length: int) -> None:
    """Fields come first: times, sizes and checksums of a chunk, offsets of an index, counts of the statistics."""
    if length:
        size = some(draw, (2, 4, 8))
        field = at + 9 + draw(st.integers(0, min(length, 64) - 1))
        value = some(draw, (0, 1, 255, *HUGE, 2**64 - 1)) % 2 ** (8 * size)
        data[field : field + size] = value.to_bytes(size, "little")


def _metadata(draw: Draw) -> Files:
    """Change metadata.yaml: other files, wrong counts, invalid YAML."""
    text = _files()[metadata.NAME]
    return _files() | {metadata.NAME: mutation(draw, (of_text, of_bytes, _tree, _tree, _aliases))(draw, text)}


def _aliases(_draw: Draw, text: bytes) -> bytes:
    levels = b"\n".join(b"a%d: &a%d [%s]" % (k, k, b", ".join([b"*a%d" % (k - 1)] * 9)) for k in range(1, 9))
    return b"a0: &a0 x\n" + levels + b"\n" + text


_ELSEWHERE = (f"../{OUTSIDE}", f"../../{OUTSIDE}", "/etc/passwd", f"{NAME}/../../../{OUTSIDE}", "..", "", ".", "/")
_FIELDS: dict[str, tuple[Any, ...]] = {
    "relative_file_paths": (
        *([name] for name in _ELSEWHERE),
        *([NAME, name] for name in _ELSEWHERE),
        *([NAME] * 50, [], None, NAME, {"a": 1}, [None], [3]),
    ),
    "files": (None, [], "x", 3, *([{"path": name}] for name in _ELSEWHERE)),
    "storage_identifier": ("sqlite3", "../mcap", None, [], {}, "os"),
    "compression_mode": ("FILE", "MESSAGE", "STORAGE", "x", None, 3),
    "compression_format": ("zstd", "lz4", "../x", None),
    "version": (0, 1, 4, 10, 10**9, -1, "9", None, [], float("nan")),
    "message_count": (0, -1, 10**18, None, "x", 1e300),
    "duration": ({}, None, 3, {"nanoseconds": -1}, {"nanoseconds": 2**80}, {"nanoseconds": "x"}),
    "starting_time": ({}, None, {"nanoseconds_since_epoch": -(2**70)}),
    "topics_with_message_count": (None, [], {}, [None], [{"topic_metadata": {}}], 3),
    "custom_data": ({"a": "b"}, [], 3),
}


def _tree(draw: Draw, text: bytes) -> bytes:
    tree = YAML(typ="safe").load(text.decode())
    content = tree["rosbag2_bagfile_information"]
    key = some(draw, sorted(_FIELDS))
    content[key] = some(draw, _FIELDS[key])
    if content[key] in ("FILE", "MESSAGE"):
        content["compression_format"] = "zstd"
    return metadata.as_yaml(tree).encode()


def _disguised(draw: Draw) -> Files | bytes:
    """Something else in the place of a bag, or an interrupted one."""
    whole = _files()[NAME]
    others: tuple[Files | bytes, ...] = (
        *({}, b"", b"x", whole, _files()[metadata.NAME]),
        {metadata.NAME: None, NAME: None},  # folders
        {f"bag_{k}.mcap": whole for k in range(3)},
        {NAME: whole[: draw(st.integers(0, len(whole)))]},
    )
    return some(draw, others)


# messages -----------------------------------------------------------------------------------------


def _messages(draw: Draw) -> Files:
    """Change messages: truncated, left out, doubled, in another topic, mutated."""
    messages = list(_content()[1])
    for _ in range(draw(st.integers(1, 3))):
        chosen = some(draw, sorted(_content()[0]))
        if places := [k for k, (name, *_) in enumerate(messages) if name == chosen]:
            k = some(draw, places)
            messages[k : k + 1] = mutation(draw, _OF_MESSAGES)(draw, messages, k)
            if chance(draw, 15):
                messages = [one for one in messages if one[0] != chosen]
    return _written(messages)


def _cut_short(draw: Draw, messages: Messages, k: int) -> Messages:
    name, stamp, raw = messages[k]
    return [(name, stamp, raw[: draw(st.integers(0, len(raw)))])]


def _of_another(draw: Draw, messages: Messages, k: int) -> Messages:
    return [(*messages[k][:2], some(draw, messages)[2])]


def _mutated(draw: Draw, messages: Messages, k: int) -> Messages:
    return [(*messages[k][:2], of_bytes(draw, messages[k][2]))]


def _twice(_draw: Draw, messages: Messages, k: int) -> Messages:
    return [messages[k]] * 2


def _left_out(_draw: Draw, _messages: Messages, _k: int) -> Messages:
    return []


_OF_MESSAGES = (_cut_short, _of_another, _mutated, _mutated, _twice, _left_out)


def _arrays(draw: Draw) -> Files:
    """Change the npz of state, settings, journal or contact sets, in the zip or in its records."""
    messages = list(_content()[1])
    name = some(draw, ("state", "state", "settings", "journal", "journal", "contact_set", "organ"))
    k = some(draw, [k for k, (topic, *_) in enumerate(messages) if topic.endswith(f"/{name}")] or [0])
    topic, stamp, raw = messages[k]
    with np.load(io.BytesIO(parse_octets(raw).tobytes()), allow_pickle=False) as stored:
        arrays = {key: stored[key] for key in stored.files}
    if draw(st.integers(0, 199)) == 199:
        data = bomb(draw, members(arrays))
    elif chance(draw, 40):
        data = of_zip(draw, members(arrays))
    else:
        for _ in range(draw(st.integers(1, 3))):
            key = some(draw, sorted(arrays))
            arrays[key] = _with_other_records(draw, np.array(arrays[key]))
        data = packed(members(arrays))
    messages[k] = topic, stamp, b"\0\1\0\0" + struct.pack("<III", 0, 0, len(data)) + data  # UInt8MultiArray
    return _written(messages)


def _with_other_records(draw: Draw, array: NDArray) -> NDArray:
    """Change a number in a record, or the whole array."""
    names = array.dtype.names
    if not names:
        return of_array(draw, array)
    flat = array.reshape(-1)
    if not array.size or chance(draw, 20):
        return some(draw, (flat[:0], flat[:1], np.zeros(3), array[names[0]]))
    field = flat[some(draw, names)]
    place = tuple(draw(st.integers(0, size - 1)) for size in field.shape) if field.size else None
    if place is not None and field.dtype.kind in "iuf":
        field[place] = odd_value(draw, field)
    return flat.reshape(array.shape)


def _config(draw: Draw) -> Files:
    """Change the configuration: invalid names, numbers and tools."""
    messages = list(_content()[1])
    k = next(k for k, (topic, *_) in enumerate(messages) if topic.endswith("/config"))
    topic, stamp, raw = messages[k]
    tree = json.loads(parse_text(raw))
    _change_config(draw, tree)
    text = json.dumps(tree)
    if chance(draw, 10):
        text = some(draw, ("", "null", "[]", "{}", "[" * 100_000, text[: len(text) // 2]))
    encoded = text.encode() + b"\0"
    messages[k] = topic, stamp, b"\0\1\0\0" + struct.pack("<I", len(encoded)) + encoded
    return _written(messages)


def _change_config(draw: Draw, tree: dict[str, Any]) -> None:
    mesh = next((name for name in tree["parameters"] if name.endswith(".mesh")), None)
    if mesh and chance(draw, 10):
        tree["parameters"][mesh] = some(draw, (f"../{OUTSIDE}", "/etc/passwd", f"../{OUTSIDE}.stl"))
        tree["parameters"][mesh.replace(".mesh", ".shape")] = "mesh"
        return
    node, key = tree, some(draw, sorted(tree))
    while isinstance(node[key], dict) and node[key] and chance(draw, 90):
        node = node[key]
        key = some(draw, sorted(node))
    value = node[key]
    if chance(draw, 15):
        del node[key]
    elif isinstance(value, bool | str | list | dict) or value is None:
        node[key] = some(draw, (None, "", "x" * 100_000, [], {}, -1, 0, 1e300, [value], [value, value], {"x": value}))
    else:
        node[key] = some(draw, (draw(ODD_FLOATS), odd_count(draw, int(value)), None, "x", [value]))


_OFTEN = (_records, _messages, _arrays)
_MUTATIONS = (*_OFTEN, *_OFTEN, _arrays, _bytes, _metadata, _disguised, _config)
