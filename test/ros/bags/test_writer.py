"""Bags cut anywhere, in several files, behind a disk that stalls: what is in them is whole."""

import shutil
import subprocess
import sys
import threading
import tracemalloc

import numpy as np
import pytest
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

from helpers.paths import ROOT
from helpers.patience import LIMIT, wait_for
from helpers.scenes import ball
from tissue_sim.cli import main
from tissue_sim.errors import UserError
from tissue_sim.model.joined import Joined
from tissue_sim.model.simulation import Simulation
from tissue_sim.ros.bags import bag, recovery, spool
from tissue_sim.ros.bags.recorder import Recorder
from tissue_sim.ros.bags.recording import Recording
from tissue_sim.ros.bags.writer import BagWriter, Split, Topic, lock
from tissue_sim.ros.shared.loop import Loop
from tissue_sim.ros.shared.organs import Organs
from tissue_sim.ros.shared.tool_topics import TOOL_TOPICS

POKE = ROOT / "bags" / "poke"
POSE = "/left/measured_cp"
EXACT = ("--force-tolerance", "0", "--position-tolerance", "0")


@pytest.fixture(scope="module")
def broken(tmp_path_factory):
    """A bag that ships, written until most of it; sizes that its file had when it was whole."""
    path = tmp_path_factory.mktemp("bags") / "broken"
    writer, sizes = BagWriter(path), []
    writer.open()
    with Reader(POKE) as reader:
        added = writer.add_topics({topic.topic: Topic(topic.msgtype, []) for topic in reader.connections})
        for number, (topic, stamp, raw) in enumerate(reader.messages()):
            writer.write(added[topic.topic], stamp, raw)
            if number % 100 == 99:
                writer.flush()
                sizes.append((path / "broken_0.mcap").stat().st_size)
            if number == 1200:
                break
    writer.abort()
    return path, sizes


def cut(broken, tmp_path, size, tail=b""):
    path = tmp_path / "broken"
    shutil.copytree(broken[0], path)
    file = path / "broken_0.mcap"
    file.write_bytes(file.read_bytes()[:size] + tail)
    return path


@pytest.mark.parametrize(
    "beyond", ["half a chunk less", *(pytest.param(more, marks=pytest.mark.extended) for more in (-1, 0, 3, 20)), 400]
)
def test_a_bag_cut_anywhere_is_completed_and_replays(broken, tmp_path, capsys, beyond):
    before, whole = broken[1][-3:-1]
    is_less = isinstance(beyond, str)
    path = cut(broken, tmp_path, (before + whole) // 2 if is_less else whole + beyond)
    assert main(["replay", str(path), *EXACT]) == 0
    first = capsys.readouterr().out
    assert first.count("was interrupted") == 1
    assert "repeats" in first
    with Reader(path) as reader:
        counted = sum(1 for _ in reader.messages())
        assert counted == reader.message_count
        assert counted == (1000 if is_less else 1100)
    assert sorted(file.name for file in path.iterdir()) == ["broken_0.mcap", "metadata.yaml"]


@pytest.mark.parametrize("tail", [b"\0" * 5000, b"\x06" + (4000).to_bytes(8, "little") + b"\7" * 5000])
def test_rubbish_after_a_power_cut_is_left_out(broken, tmp_path, tail):
    path = cut(broken, tmp_path, broken[1][2], tail)
    assert "are recovered" in recovery.complete(path)
    with Reader(path) as reader:
        assert reader.message_count == 300


@pytest.mark.parametrize("size", [0, 5, 20])
def test_a_bag_with_nothing_in_it_is_refused(broken, tmp_path, capsys, size):
    assert main(["replay", str(cut(broken, tmp_path, size))]) == 2
    assert "before it had any content" in capsys.readouterr().err


def test_a_bag_that_cannot_be_written_is_read_all_the_same(broken, tmp_path, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    path = cut(broken, tmp_path, broken[1][-1] + 3)
    before = (path / "broken_0.mcap").read_bytes()
    monkeypatch.setattr(BagWriter, "write", full)
    assert recovery.complete(path).endswith("not completed: No space left on device")
    assert [file.name for file in path.iterdir()] == ["broken_0.mcap"]
    assert (path / "broken_0.mcap").read_bytes() == before
    assert len(Recording.read(path).poses[0]) > 100


def test_a_bag_is_not_completed_while_it_is_written(broken, tmp_path):
    path = cut(broken, tmp_path, broken[1][-1])
    with (path / "broken_0.mcap").open("rb") as held:
        assert lock(held.fileno())
        with pytest.raises(UserError, match="still being recorded"):
            recovery.complete(path)


def test_files_go_on_when_one_is_large(tmp_path):
    """Random bytes, which no compression makes less of; a bag that broke off in its third file is one again."""
    random = np.random.default_rng(1)
    for end in (BagWriter.close, BagWriter.abort):
        path = tmp_path / end.__name__
        writer = BagWriter(path, Split(size=2e6))
        writer.open()
        added = writer.add_topics(
            {"/a/config": Topic("std_msgs/msg/String", []), POSE: Topic(TOOL_TOPICS["measured_cp"], [])}
        )
        sent = [random.bytes(100_000) for _ in range(50)]
        for stamp, raw in enumerate(sent):
            writer.write(added[POSE if stamp else "/a/config"], 1000 + stamp, raw)
        writer.flush()
        end(writer)
        if end is BagWriter.abort:
            assert recovery.is_interrupted(path)
            assert recovery.complete(path).count("\n") == 0
        sizes = [file.stat().st_size for file in sorted(path.glob("*.mcap"))]
        assert len(sizes) == 3
        assert max(sizes) < 3.2e6
        with Reader(path) as reader:
            assert [bytes(raw) for _, _, raw in reader.messages()] == sent
            assert sum(file["message_count"] for file in reader.storage.files) == len(sent)


@pytest.fixture
def stalled(tmp_path, monkeypatch):
    """A recorder whose disk takes nothing until it is released, and has room for 8 MB until then."""
    released, stuck = threading.Event(), threading.Event()
    write = BagWriter.write

    def when_released(self, *words):
        stuck.set()
        assert released.wait(LIMIT)
        write(self, *words)

    monkeypatch.setattr(BagWriter, "write", when_released)
    monkeypatch.setattr(spool, "MOST_WAITING", 8e6)
    organs = Organs(Loop(Joined([Simulation(ball(2))])))
    recorder = Recorder("/tissue_sim", organs, [""], {"tools": ["left"]})
    for topic in TOOL_TOPICS:
        recorder.add_topic("left", topic, f"/left/{topic}")
    organs.loop.start()
    recorder.start(tmp_path, {})
    assert stuck.wait(LIMIT)
    yield recorder, released
    released.set()
    organs.loop.stop()


def counts(path):
    with Reader(path) as reader:
        return {topic.topic: topic.msgcount for topic in reader.connections}


def test_markers_are_left_out_before_surfaces_and_inputs_never(stalled):
    recorder, released = stalled
    large = b"\0" * 100_000
    for tick in range(50):
        recorder.of_organ[0].surface(10**6 + tick, large, large, large)
        recorder.received(POSE, b"\0" * 64)
    assert recorder.active
    released.set()
    path = recorder.stop()
    assert recorder.error == ""
    found = counts(path)
    assert found[POSE] == 50
    assert 0 < found["/tissue_sim/markers"] < found["/tissue_sim/surface"] < 50
    assert recorder.lost == 150 - sum(found[f"/tissue_sim/{name}"] for name in ("markers", "surface", "skeleton"))
    with Reader(path) as reader:
        topics = [topic for topic in reader.connections if topic.topic == "/tissue_sim/journal"]
        rows = [journal_of(raw)["surfaces"] for _, _, raw in reader.messages(topics)]
    assert len(np.concatenate(rows)) == found["/tissue_sim/surface"], "a row for each that is in the bag, and no other"


def journal_of(raw):
    kind = bag.ORGAN_TOPICS["journal"]
    return bag.unpack(get_typestore(Stores.ROS2_JAZZY).deserialize_cdr(raw, kind).data)


def test_a_disk_that_is_too_far_behind_ends_the_bag_before_an_input_is_lost(stalled):
    recorder, released = stalled
    sent = 0
    while recorder.active:
        recorder.received(POSE, sent.to_bytes(4, "little") * 2500)
        sent += 1
    assert "the disk is too slow" in recorder.error
    assert 600 < sent < 900
    released.set()
    path = recorder.stop()
    with Reader(path) as reader:
        topics = [topic for topic in reader.connections if topic.topic == POSE]
        found = [int.from_bytes(raw[:4], "little") for _, _, raw in reader.messages(topics)]
    assert found == list(range(sent - 1))
    wait_for(lambda: recorder.lost == 1)


def test_the_index_of_a_long_bag_takes_no_memory(tmp_path):
    """What a node that records keeps of a thousand chunks until the bag's end is less than 50 bytes of each."""
    writer = BagWriter(tmp_path / "long")
    writer.open()
    with Reader(POKE) as reader:
        added = writer.add_topics({topic.topic: Topic(topic.msgtype, []) for topic in reader.connections})
        shown = {topic.topic: (topic, raw) for topic, _, raw in reader.messages() if len(raw) < 1000}

    def write(chunks):
        for _ in range(chunks):
            for name, (_, raw) in shown.items():
                stamps.append(stamps[-1] + 1)
                writer.write(added[name], stamps[-1], raw)
            writer._file.close_chunk()

    stamps = [10**18]
    write(50)
    tracemalloc.start()
    try:
        before = tracemalloc.get_traced_memory()[0]
        kept = len(stamps)
        write(1000)
        kept = 40 * (len(stamps) - kept)  # this list's own
        grown = tracemalloc.get_traced_memory()[0] - before - kept
    finally:
        tracemalloc.stop()
    writer.close()
    assert shown
    assert grown < 50_000
    with Reader(tmp_path / "long") as reader:
        assert [stamp for _, stamp, _ in reader.messages()] == stamps[1:]


STALLED = """
import sys, threading, time
from pathlib import Path
from tissue_sim.ros.bags.spool import Spool
from tissue_sim.ros.bags.writer import BagWriter, Topic

def resident():
    return 4096 * int(Path("/proc/self/statm").read_text().split()[1])

def fill(count):
    released.clear()
    for number in range(count):
        assert spool.put("/pose", number.to_bytes(8, "little") * 12)
    released.set()
    while spool._count:
        time.sleep(0.05)
    time.sleep(1.0)

released, write = threading.Event(), BagWriter.write
BagWriter.write = lambda *words: released.wait() and write(*words)
writer = BagWriter(Path(sys.argv[1]))
writer.open()
spool = Spool(writer, writer.add_topics({"/pose": Topic("geometry_msgs/msg/PoseStamped", [])}), {})
fill(1000)
before = resident()
fill(100_000)
print(resident() - before)
spool.close(30.0)
"""


@pytest.mark.extended
def test_what_waited_for_a_stalled_disk_leaves_no_memory(tmp_path):
    """100,000 small messages, 12 MB, wait at once."""
    printed = subprocess.run(
        [sys.executable, "-c", STALLED, tmp_path / "stalled"], capture_output=True, text=True, check=True
    )
    assert int(printed.stdout) < 1e6
    with Reader(tmp_path / "stalled") as reader:
        found = [int.from_bytes(raw[:8], "little") for _, _, raw in reader.messages()]
    assert found == [*range(1000), *range(100_000)]
