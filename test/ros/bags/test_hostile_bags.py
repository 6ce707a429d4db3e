"""Bags whose records lie: refused with one line that names the bag, without the room that a length asks for."""

import dataclasses
import shutil
import struct

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped, WrenchStamped
from lz4.frame import compress as lz4
from rosbags.rosbag2 import Reader
from rosbags.rosbag2.storage_mcap import zstd

from helpers.paths import ROOT
from tissue_sim.cli import main
from tissue_sim.errors import UserError
from tissue_sim.ros.bags import metadata, recovery
from tissue_sim.ros.bags.player import replay
from tissue_sim.ros.bags.recording import Recording
from tissue_sim.ros.bags.writer import BagWriter, Topic
from tissue_sim.ros.shared.messages import NumbersTemplate

BAG = ROOT / "bags" / "poke"
LARGE = recovery.LARGEST_CHUNK


@pytest.fixture
def bag(tmp_path):
    """A copy, its file, and the file's bytes."""
    shutil.copytree(BAG, tmp_path / "bag")
    (file,) = (tmp_path / "bag").glob("*.mcap")
    return tmp_path / "bag", file, bytearray(file.read_bytes())


@pytest.fixture(scope="module")
def recording():
    return Recording.read(BAG)


def records(data):
    at = len(recovery.MAGIC)
    while at + 9 <= len(data):
        opcode, length = struct.unpack_from("<BQ", data, at)
        yield opcode, at, length
        at += 9 + length


def first_chunk(data):
    return next((at, length) for opcode, at, length in records(data) if opcode == recovery.CHUNK)


def with_chunk(data, says, compression, packed):
    """Its first chunk replaced."""
    at, length = first_chunk(data)
    name = compression.encode()
    body = struct.pack("<QQQI", 0, 2**62, says, 0) + struct.pack("<I", len(name)) + name
    body += struct.pack("<Q", len(packed)) + packed
    return data[:at] + struct.pack("<BQ", recovery.CHUNK, len(body)) + body + data[at + 9 + length :]


def refused(capsys, path):
    """The line with which replay refuses."""
    assert main(["replay", str(path)]) == 2
    found = capsys.readouterr().err
    assert found.count("\n") == 1
    assert str(path) in found
    return found


BOMB = zstd.compress(bytes(LARGE + 1000))


@pytest.mark.parametrize(
    ("says", "compression", "packed"),
    [
        (1000, "zstd", BOMB),
        (1000, "zstd", zstd.compress(bytes(1000)) + BOMB),
        (1000, "lz4", lz4(bytes(50_000_000))),
        (LARGE + 1000, "zstd", BOMB),
        (2**63, "zstd", BOMB),
        (2000, "zstd", zstd.compress(bytes(1000))),
        (1000, "zstd", zstd.compress(bytes(1000))[:-3]),
        (1000, "zstd", b"rubbish"),
        (1000, "lz4", b"rubbish"),
        (1000, "", bytes(1001)),
        (1000, "bz2", bytes(1000)),
    ],
)
@pytest.mark.parametrize("broken_off", [False, True])
def test_a_chunk_that_lies_is_refused(bag, capsys, monkeypatch, says, compression, packed, broken_off):
    path, file, data = bag
    file.write_bytes(with_chunk(data, says, compression, packed))
    if broken_off:
        (path / metadata.NAME).unlink()
    # Nothing but the bounded way may unpack it.
    monkeypatch.setattr(zstd, "decompress", lambda *_: pytest.fail("unpacked without a bound"))
    refused(capsys, path)


def test_chunks_of_lz4_and_unpacked_ones_are_read(bag):
    path, file, data = bag
    expected = [raw for _, _, raw in recovery_messages(path, file, data)]
    for compression, pack in (("lz4", lz4), ("", bytes)):
        made = data
        for opcode, at, length in reversed(list(records(data))):
            if opcode == recovery.CHUNK:
                chunk = bytes(data[at + 9 : at + 9 + length])
                start, end, size, crc = struct.unpack_from("<QQQI", chunk)
                packed = pack(zstd.decompress(chunk[28 + 4 + 4 + 8 :]))
                name = compression.encode()
                body = struct.pack("<QQQI", start, end, size, crc) + struct.pack("<I", len(name)) + name
                body += struct.pack("<Q", len(packed)) + packed
                made = made[:at] + struct.pack("<BQ", opcode, len(body)) + body + made[at + 9 + length :]
        assert [raw for _, _, raw in recovery_messages(path, file, made)] == expected
    assert len(expected) > 1000


def recovery_messages(path, file, data):
    """Those of a bag as it is while it is recorded, so without its index."""
    (path / metadata.NAME).unlink(missing_ok=True)
    end = next(at for opcode, at, _ in records(data) if opcode == recovery.DATA_END)
    file.write_bytes(data[:end])
    return recovery.messages(path)


def test_bits_that_zstd_finds_wrong_are_reported(bag, capsys):
    path, file, data = bag
    at, _ = first_chunk(data)
    data[at + 9 + 44 : at + 9 + 44 + 20] = bytes(20)
    file.write_bytes(data)
    assert "can't be read: Unable to decompress Zstandard data" in refused(capsys, path)


@pytest.mark.parametrize("length", [2**63 - 1, 2**64 - 1, 2**40])
def test_a_header_that_goes_beyond_its_file_is_refused(bag, capsys, length):
    path, file, data = bag
    struct.pack_into("<Q", data, len(recovery.MAGIC) + 1, length)
    file.write_bytes(data)
    assert "in a file of" in refused(capsys, path)
    (path / metadata.NAME).unlink()
    assert "interrupted before it had any content" in refused(capsys, path)


def test_a_message_type_that_nobody_knows_is_reported(bag, capsys):
    """In the summary of a bag that lacks its metadata: it can't be completed."""
    path, file, data = bag
    (path / metadata.NAME).unlink()
    file.write_bytes(data.replace(b"std_msgs/msg/String", b"std_msgs/msg/Strong"))
    assert "'std_msgs/msg/Strong' is missing or unknown" in refused(capsys, path)


def test_metadata_of_another_storage_is_refused(bag, capsys):
    path, _, _ = bag
    metadata_file = path / metadata.NAME
    metadata_file.write_text(
        metadata_file.read_text().replace("storage_identifier: mcap", "storage_identifier: sqlite3")
    )
    assert "has storage sqlite3" in refused(capsys, path)


@pytest.mark.parametrize("mode", ["FILE", "MESSAGE"])
def test_what_is_packed_without_a_length_is_refused(bag, capsys, monkeypatch, mode):
    """Files and messages, which rosbags would unpack to whatever comes."""
    path, _, _ = bag
    metadata_file = path / metadata.NAME
    text = metadata_file.read_text().replace("compression_mode: ''", f"compression_mode: {mode}")
    metadata_file.write_text(text.replace("compression_format: ''", "compression_format: zstd"))
    for name in ("decompress", "open"):
        monkeypatch.setattr(zstd, name, lambda *_: pytest.fail("unpacked without a bound"))
    assert f"compression {mode.lower()}" in refused(capsys, path)


def test_a_file_of_any_name_is_looked_through_before_it_is_read(bag, capsys, monkeypatch):
    path, file, data = bag
    file.unlink()
    (path / "bag.dat").write_bytes(with_chunk(data, 1000, "zstd", BOMB))
    metadata_file = path / metadata.NAME
    metadata_file.write_text(metadata_file.read_text().replace(file.name, "bag.dat"))
    monkeypatch.setattr(zstd, "decompress", lambda *_: pytest.fail("unpacked without a bound"))
    assert "unpack" in refused(capsys, path)


@pytest.mark.parametrize(
    ("topic", "values", "expected"),
    [
        ("measured_cp", (np.nan, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0), "metres"),
        ("measured_cp", (1e300, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0), "metres"),
        ("external_cf", (np.inf, 0.0, 0.0, 0.0, 0.0, 0.0), "newtons"),
    ],
)
def test_poses_and_forces_that_no_node_takes_up_are_refused(tmp_path, capsys, topic, values, expected):
    kind = {"measured_cp": PoseStamped, "external_cf": WrenchStamped}[topic]
    odd = NumbersTemplate(kind(), len(values), "organ").message(1, values)
    was = {"external_cf": "measured_cf"}.get(topic, topic)  # in bags of format 8
    names, source = (f"left/{topic}", f"left/{was}"), ROOT / "bags" / ("poke" if topic == was else "local_force")
    path = rewritten(tmp_path / "bag", lambda name, raw: odd if name.endswith(names) else raw, source)
    assert expected in refused(capsys, path)


def test_a_bag_without_settings_is_refused(tmp_path, capsys):
    path = rewritten(tmp_path / "bag", lambda name, raw: b"" if name.endswith("/settings") else raw)
    assert "has no settings" in refused(capsys, path)


def rewritten(path, changed, source=BAG):
    """The bag with other bytes, or without messages that become none."""
    writer = BagWriter(path)
    writer.open()
    with Reader(source) as reader:
        topics = {one.topic: Topic(one.msgtype, metadata.qos_of(one)) for one in reader.connections}
    places = writer.add_topics(topics)
    for name, stamp, raw in contents(source):
        if found := changed(name, raw):
            writer.write(places[name], stamp, found)
    writer.close()
    return path


def contents(source=BAG):
    with Reader(source) as reader:
        return [(topic.topic, stamp, bytes(raw)) for topic, stamp, raw in reader.messages()]


def with_organ(recording, **changed):
    """The recording with other content of its organ."""
    return dataclasses.replace(recording, organs=[dataclasses.replace(recording.organs[0], **changed)])


def test_lost_settings_are_named(recording):
    (organ,) = recording.organs
    inputs = organ.journal["inputs"].copy()
    inputs["settings"][len(inputs) // 2 :] = 77
    with pytest.raises(UserError, match="the bag has no settings number 77"):
        replay(with_organ(recording, journal={**organ.journal, "inputs": inputs}))


def test_surfaces_of_another_organ_are_reported(recording):
    more = [np.concatenate([surface, surface]) for surface in recording.organs[0].surfaces]
    with pytest.raises(UserError, match=r"surfaces have .* points, but the organ has .*: it is another organ"):
        replay(with_organ(recording, surfaces=more))
