"""Hostile bags: metadata that names other files, wrong lengths, truncated messages, journals that name nothing."""

from __future__ import annotations

import contextlib
import io
import json
import struct
import tempfile
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.interfaces import Connection
from rosbags.rosbag2 import Reader
from ruamel.yaml import YAML

from tissue_sim.bench.fuzz.cases import SCENE, Broken, Case, Input
from tissue_sim.bench.fuzz.files.mutations import HUGE, Rng, odd_count, odd_float, of_array, of_bytes, of_text, some
from tissue_sim.bench.fuzz.files.zips import OUTSIDE, bomb, members, of_zip, packed
from tissue_sim.organ.shipped import shipped_file
from tissue_sim.ros.bags import metadata, recovery
from tissue_sim.ros.bags.outcome import Asked, replay_bag
from tissue_sim.ros.bags.writer import BagWriter, Topic
from tissue_sim.ros.shared.cdr import parse_octets, parse_text

NAME = "bag_0.mcap"
_BOMBS = 0.005  # fraction of the cases
_ASKED = Asked(force_tolerance=1e-6, position_tolerance=1e-6)

Messages = list[tuple[str, int, bytes]]  # topic, stamp in ns, bytes


def prepare(case: Case, folder: Path) -> Input:
    """Make a bag with one or more mutations."""
    rng, path = case.rng(), folder / "bag"
    way: Callable[[Rng, Path], str] = some(rng, _WAYS)
    what = way(rng, path)
    if rng.random() < 0.1 and (path / metadata.NAME).is_file():
        (path / metadata.NAME).unlink()
        what = f"{what}; interrupted"
    return Input(what, lambda: use(path))


def warm_up(folder: Path) -> None:
    """Replay the intact bag."""
    _write(_content()[1], folder / "bag")
    use(folder / "bag")


def use(path: Path) -> str:
    """Do what `tissue_sim replay` does: complete, read, replay, compare."""
    with contextlib.redirect_stdout(io.StringIO()):
        if recovery.is_interrupted(path):
            recovery.complete(path)
        outcome = replay_bag(path, _ASKED)
    found, shown = outcome.comparison, outcome.replayed.shown
    if not all(bool(np.isfinite(np.asarray(values)).all()) for values in (*shown.wrenches, *shown.surfaces)):
        raise Broken("a replay that shows numbers that are not finite")
    same = "repeats" if found.passes else "differs"
    return f"{outcome.replayed.ticks} ticks, {found.wrenches} wrenches, {found.surfaces} surfaces: {same}"


# a whole bag --------------------------------------------------------------------------------------


@lru_cache(maxsize=1)
def _content() -> tuple[dict[str, Topic], Messages]:
    """Return topics and messages of a short recording."""
    source = shipped_file(SCENE)
    assert source is not None  # see cases.Kind.needs
    with Reader(source.parent) as reader:
        topics = {topic.topic: Topic(topic.msgtype, metadata.qos_of(topic)) for topic in reader.connections}
        return topics, [(topic.topic, stamp, bytes(raw)) for topic, stamp, raw in reader.messages()]


def _write(messages: Messages, path: Path) -> None:
    topics, _ = _content()
    writer = BagWriter(path)
    writer.open()
    added: dict[str, Connection] = writer.add_topics(topics)
    for name, stamp, raw in messages:
        writer.write(added[name], stamp, raw)
    writer.close()


@lru_cache(maxsize=1)
def _files() -> dict[str, bytes]:
    """Return the files of the intact bag, made once."""
    with tempfile.TemporaryDirectory() as folder:
        _write(_content()[1], Path(folder) / "bag")
        return {path.name: path.read_bytes() for path in sorted((Path(folder) / "bag").iterdir())}


def _put(files: dict[str, bytes], path: Path) -> None:
    path.mkdir()
    for name, data in files.items():
        (path / name).write_bytes(data)


# files --------------------------------------------------------------------------------------------


def _bytes(rng: Rng, path: Path) -> str:
    files = dict(_files())
    files[NAME], told = of_bytes(rng, files[NAME])
    _put(files, path)
    return told


def _records(rng: Rng, path: Path) -> str:
    """Change records of the MCAP file: wrong lengths, opcodes and fields, some left out or duplicated."""
    files, told = dict(_files()), []
    data = bytearray(files[NAME])
    for _ in range(int(rng.integers(1, 3))):
        places = list(_record_places(data))
        if not places:
            break
        at, length = some(rng, places)
        told.append(_record(rng, data, at, length))
    files[NAME] = bytes(data)
    _put(files, path)
    return "; ".join(told)


def _record_places(data: bytes | bytearray) -> list[tuple[int, int]]:
    """Return where records begin, and their lengths; those of a summary as likely as chunks."""
    places, at = [], len(recovery.MAGIC)
    while at + 9 <= len(data):
        length = struct.unpack_from("<Q", data, at + 1)[0]
        if at + 9 + length > len(data):
            break
        places.append((at, length))
        at += 9 + length
    return places


def _record(rng: Rng, data: bytearray, at: int, length: int) -> str:
    opcode, way = data[at], rng.random()
    if way < 0.25:
        lie = odd_count(rng, length) % 2**64
        struct.pack_into("<Q", data, at + 1, lie)
        return f"record {opcode:#x} at {at} of {lie} bytes"
    if way < 0.35:
        data[at] = int(rng.integers(20))
        return f"record {opcode:#x} at {at} as {data[at]:#x}"
    if way < 0.45:
        del data[at : at + 9 + length]
        return f"record {opcode:#x} at {at} left out"
    if way < 0.55:
        data[at:at] = data[at : at + 9 + length]
        return f"record {opcode:#x} at {at} twice"
    if not length:
        return "nothing"
    # Fields come first: times, sizes and checksums of a chunk, offsets of an index, counts of the statistics.
    size = some(rng, (2, 4, 8))
    field = at + 9 + int(rng.integers(min(length, some(rng, (8, 16, 32, 64)))))
    value = some(rng, (0, 1, 255, *HUGE, 2**64 - 1)) % 2 ** (8 * size)
    data[field : field + size] = value.to_bytes(size, "little")
    return f"{value} in record {opcode:#x} at {at}"


def _metadata(rng: Rng, path: Path) -> str:
    """Change metadata.yaml: other files, wrong counts, invalid YAML."""
    files = dict(_files())
    draw = rng.random()
    if draw < 0.4:
        files[metadata.NAME], told = of_text(rng, files[metadata.NAME])
    elif draw < 0.5:
        files[metadata.NAME], told = of_bytes(rng, files[metadata.NAME])
    else:
        tree = YAML(typ="safe").load(files[metadata.NAME].decode())
        told = _metadata_tree(rng, tree)
        files[metadata.NAME] = metadata.as_yaml(tree).encode()
    if draw > 0.97:
        levels = b"\n".join(b"a%d: &a%d [%s]" % (k, k, b", ".join([b"*a%d" % (k - 1)] * 9)) for k in range(1, 9))
        files[metadata.NAME], told = b"a0: &a0 x\n" + levels + b"\n" + files[metadata.NAME], "aliases of aliases"
    _put(files, path)
    return f"metadata: {told}"


def _metadata_tree(rng: Rng, tree: dict[str, Any]) -> str:
    told = tree["rosbag2_bagfile_information"]
    elsewhere = some(rng, (OUTSIDE, f"../{OUTSIDE}", "/etc/passwd", "bag_0.mcap/../../../outside", "..", "", ".", "/"))
    key, value = some(
        rng,
        (
            ("relative_file_paths", [elsewhere]),
            ("relative_file_paths", [NAME, elsewhere]),
            ("relative_file_paths", [NAME] * 50),
            ("relative_file_paths", some(rng, ([], None, "bag_0.mcap", {"a": 1}, [None], [3]))),
            ("files", some(rng, (None, [], [{"path": elsewhere}], "x", 3))),
            ("storage_identifier", some(rng, ("sqlite3", "../mcap", None, [], {}, "os"))),
            ("compression_mode", some(rng, ("FILE", "MESSAGE", "STORAGE", "x", None, 3))),
            ("compression_format", some(rng, ("zstd", "lz4", "../x", None))),
            ("version", some(rng, (0, 1, 4, 10, 10**9, -1, "9", None, [], float("nan")))),
            ("message_count", some(rng, (0, -1, 10**18, None, "x", 1e300))),
            ("duration", some(rng, ({}, None, 3, {"nanoseconds": -1}, {"nanoseconds": 2**80}, {"nanoseconds": "x"}))),
            ("starting_time", some(rng, ({}, None, {"nanoseconds_since_epoch": -(2**70)}))),
            ("topics_with_message_count", some(rng, (None, [], {}, [None], [{"topic_metadata": {}}], 3))),
            ("custom_data", some(rng, ({"a": "b"}, [], 3))),
        ),
    )
    told[key] = value
    if key == "compression_mode" and value in ("FILE", "MESSAGE"):
        told["compression_format"] = "zstd"
    return f"{key}: {str(value)[:40]}"


def _disguised(rng: Rng, path: Path) -> str:
    """Put something else in the place of a bag."""
    files = dict(_files())
    draw = int(rng.integers(5))
    if draw == 0:
        _put({}, path)
        return "an empty folder"
    if draw == 1:
        path.write_bytes(some(rng, (b"", b"x", files[NAME], files[metadata.NAME])))
        return "a file"
    if draw == 2:
        path.mkdir()
        (path / metadata.NAME).mkdir()
        (path / NAME).mkdir()
        return "folders in place of its files"
    if draw == 3:
        _put({f"bag_{k}.mcap": files[NAME] for k in range(3)}, path)
        return "interrupted, with its file three times"
    cut = int(rng.integers(len(files[NAME])))
    _put({NAME: files[NAME][:cut]}, path)
    return f"interrupted after {cut} bytes"


# messages -----------------------------------------------------------------------------------------


def _messages(rng: Rng, path: Path) -> str:
    """Change messages: truncated, left out, shuffled, in another topic, mutated."""
    messages, told = list(_content()[1]), []
    names = sorted({name for name, *_ in messages})
    for _ in range(int(rng.integers(1, 4))):
        chosen = some(rng, names)
        places = [k for k, (name, *_) in enumerate(messages) if name == chosen]
        if not places:
            continue
        k = some(rng, places)
        name, stamp, raw = messages[k]
        way = int(rng.integers(7))
        if way == 0:
            messages[k] = name, stamp, raw[: int(rng.integers(len(raw) + 1))]
        elif way == 1:
            del messages[k]
        elif way == 2:
            messages = [one for one in messages if one[0] != name]
        elif way == 3:
            messages.insert(k, messages[k])
        elif way == 4:
            messages[k] = name, stamp, some(rng, messages)[2]
        else:
            messages[k] = name, stamp, of_bytes(rng, raw)[0]
        how = ("cut short", "left out", "left out of all", "twice", "another's", "mutated", "mutated")[way]
        told.append(f"{name} {how}")
    _write(messages, path)
    return "; ".join(told) or "nothing"


def _arrays(rng: Rng, path: Path) -> str:
    """Change the npz of state, settings, journal or contact sets, in the zip or in its records."""
    messages = list(_content()[1])
    name = some(rng, ("state", "state", "settings", "journal", "journal", "contact_set", "organ"))
    k = some(rng, [k for k, (topic, *_) in enumerate(messages) if topic.endswith(f"/{name}")] or [0])
    topic, stamp, raw = messages[k]
    with np.load(io.BytesIO(parse_octets(raw).tobytes()), allow_pickle=False) as stored:
        arrays = {key: stored[key] for key in stored.files}
    draw = rng.random()
    if draw < _BOMBS:
        data, told = bomb(rng, members(arrays))
    elif draw < 0.4:
        data, told = of_zip(rng, members(arrays))
    else:
        data, told = _fields(rng, arrays)
    messages[k] = topic, stamp, _octets(data)
    _write(messages, path)
    return f"{name}: {told}"


def _fields(rng: Rng, arrays: dict[str, np.ndarray]) -> tuple[bytes, str]:
    """Change a number in a record, or a whole array."""
    told = []
    for _ in range(int(rng.integers(1, 4))):
        key = some(rng, sorted(arrays))
        array = np.array(arrays[key])
        names = array.dtype.names
        if names and array.size and rng.random() < 0.8:
            field = some(rng, names)
            flat = array.reshape(-1)
            at = int(rng.integers(len(flat)))
            part = flat[field][at : at + 1].reshape(-1).copy()
            if part.size and part.dtype.kind in "iu":
                limits = np.iinfo(part.dtype)
                part[int(rng.integers(part.size))] = np.clip(odd_count(rng, int(part.max())), limits.min, limits.max)
            elif part.size and part.dtype.kind == "f":
                part[int(rng.integers(part.size))] = odd_float(rng)
            flat[field][at : at + 1] = part.reshape(flat[field][at : at + 1].shape)
            arrays[key] = flat.reshape(array.shape)
            told.append(f"{key}'s {field}")
        elif names:
            arrays[key] = some(rng, (array.reshape(-1)[:0], array.reshape(-1)[:1], np.zeros(3), array[names[0]]))
            told.append(f"another {key}")
        else:
            arrays[key], how = of_array(rng, array)
            told.append(f"{key} {how}")
    return packed(members(arrays)), "; ".join(told)


def _config(rng: Rng, path: Path) -> str:
    """Change the configuration: invalid names, numbers and tools."""
    messages = list(_content()[1])
    k = next(k for k, (topic, *_) in enumerate(messages) if topic.endswith("/config"))
    topic, stamp, raw = messages[k]
    tree = json.loads(parse_text(raw))
    told = _config_tree(rng, tree)
    text = json.dumps(tree)
    if rng.random() < 0.1:
        text, told = some(rng, ("", "null", "[]", "{}", "[" * 100_000, text[: len(text) // 2])), "no configuration"
    encoded = text.encode() + b"\0"
    messages[k] = topic, stamp, b"\0\1\0\0" + struct.pack("<I", len(encoded)) + encoded
    _write(messages, path)
    return f"config: {told}"


def _config_tree(rng: Rng, tree: dict[str, Any]) -> str:
    node, key = tree, some(rng, sorted(tree))
    while isinstance(node[key], dict) and node[key] and rng.random() < 0.9:
        node = node[key]
        key = some(rng, sorted(node))
    value = node[key]
    mesh = next((name for name in tree["parameters"] if name.endswith(".mesh")), None)
    if mesh and rng.random() < 0.1:
        tree["parameters"][mesh] = some(rng, (OUTSIDE, "/etc/passwd", f"{OUTSIDE}.stl"))
        tree["parameters"][mesh.replace(".mesh", ".shape")] = "mesh"
        return f"a tool's mesh at {tree['parameters'][mesh]}"
    if rng.random() < 0.15:
        del node[key]
        return f"{key} left out"
    if isinstance(value, bool | str | list | dict) or value is None:
        node[key] = some(rng, (None, "", "x" * 100_000, [], {}, -1, 0, 1e300, [value], [value, value], {"x": value}))
    else:
        node[key] = some(rng, (odd_float(rng), odd_count(rng, int(value)), None, "x", [value]))
    return f"{key} {str(node[key])[:30]}"


def _octets(data: bytes) -> bytes:
    """Return a UInt8MultiArray without dimensions."""
    return b"\0\1\0\0" + struct.pack("<III", 0, 0, len(data)) + data


_WAYS = (_bytes, _records, _records, _metadata, _disguised, _messages, _messages, _arrays, _arrays, _arrays, _config)
