"""A node that is killed, or whose disk is full, leaves a bag that opens and replays: real processes."""

import importlib.util
import os
import random
import resource
import signal
import time
from pathlib import Path

import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from rosbags.rosbag2 import Reader

from helpers.patience import wait_for
from helpers.ros.clients import Client
from helpers.ros.processes import UNHURRIED, Process, running_node
from tissue_sim.cli import main
from tissue_sim.ros.bags import recovery

EXACT = ("--force-tolerance", "0", "--position-tolerance", "0")
MOMENTS = [(seed, random.Random(seed).uniform(0.0, 3.0), random.Random(-seed).uniform(0.0, 1.0)) for seed in range(22)]


def start_bridge(folder: Path) -> Process:
    """A scripted haptic bridge, until it is stopped."""
    return Process(["-m", "tissue_sim", "bridge"], folder / "bridge.log")


def newest_on_disk(bag: Path) -> int:
    """Stamp, ns, of the newest message that another process would find in a bag which is still recorded."""
    return max((stamp for _, stamp, _ in recovery.messages(bag)), default=0)


def opens_elsewhere(bag: Path) -> None:
    """rosbags and, where it is there, mcap read all of a bag."""
    with Reader(bag) as reader:
        count = sum(1 for _ in reader.messages())
        assert count == reader.message_count > 0
        assert reader.ros_distro == "jazzy"
    if importlib.util.find_spec("mcap"):
        from mcap.reader import make_reader

        found = 0
        for path in bag.glob("*.mcap"):
            with path.open("rb") as stream:
                found += sum(1 for _ in make_reader(stream).iter_messages())
        assert found == count


def kill_and_replay(folder: Path, start, capsys, moment: float, phase: float) -> None:
    node = start(folder, "record:=true", f"record_folder:={folder / 'bags'}", UNHURRIED)
    bridge = start_bridge(folder)
    (bag,) = (folder / "bags").iterdir()
    bridge.wait_for("stroke")
    time.sleep(moment)
    queued = time.time_ns()
    wait_for(lambda: time.sleep(0.1) or newest_on_disk(bag) > queued, "nothing more reaches the disk")
    assert main(["replay", str(bag)]) == 2
    assert "is still being recorded" in capsys.readouterr().err
    time.sleep(phase)
    node.child.kill()
    node.child.wait()
    bridge.stop()
    assert not (bag / "metadata.yaml").exists()
    assert main(["replay", str(bag), *EXACT]) == 0
    out = capsys.readouterr().out
    assert out.count("was interrupted") == 1
    assert "s of it are recovered" in out
    assert "repeats" in out
    opens_elsewhere(bag)
    with Reader(bag) as reader:
        assert reader.end_time > queued
    assert main(["replay", str(bag), *EXACT]) == 0
    assert "interrupted" not in capsys.readouterr().out


@pytest.mark.parametrize(
    ("seed", "moment", "phase"), [MOMENTS[1], pytest.param(*MOMENTS[0], marks=pytest.mark.extended)]
)
def test_what_was_recorded_before_a_kill_replays(tmp_path, start, capsys, seed, moment, phase):
    kill_and_replay(tmp_path, start, capsys, moment, phase)


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "moment", "phase"), MOMENTS[2:])
def test_what_was_recorded_before_a_kill_replays_always(tmp_path, start, capsys, seed, moment, phase):
    kill_and_replay(tmp_path, start, capsys, moment, phase)


@pytest.mark.extended
def test_a_full_disk_ends_the_bag_and_nothing_else(tmp_path, capsys):
    """The node is allowed no larger file than some MB, which looks the same to it."""
    with running_node(tmp_path, UNHURRIED, f"record_folder:={tmp_path / 'bags'}") as node:
        client = Client(markers=False)
        assert client.spin_until(lambda: client.diagnostics)
        resource.prlimit(node.child.pid, resource.RLIMIT_FSIZE, (2_000_000, resource.RLIM_INFINITY))
        started = client.record(True)
        assert started.success, started.message
        bridge = start_bridge(tmp_path)

        def is_reported():
            client.report()
            return client.level == DiagnosticStatus.ERROR and "recording" in client.message

        assert client.spin_until(is_reported)
        expected = f"recording to {started.message} failed: {os.strerror(27)}"
        assert expected in client.message
        assert client.diagnostics["recording"] == ""
        stopped = client.record(False)
        assert (stopped.success, stopped.message) == (False, expected)
        tick = int(client.report()["tick"])
        assert client.spin_until(lambda: int(client.diagnostics["tick"]) > tick + 200), "the node goes on"
        bridge.stop()
        resource.prlimit(node.child.pid, resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
        again = client.record(True)
        assert again.success, again.message
        assert client.record(False).success
        client.close()
    assert main(["replay", started.message, *EXACT]) == 0
    assert "was interrupted" in capsys.readouterr().out
    opens_elsewhere(Path(started.message))


@pytest.mark.extended
def test_a_bag_that_is_still_recorded_is_left_alone(tmp_path, start, capsys):
    node = start(tmp_path, "record:=true", f"record_folder:={tmp_path / 'bags'}")
    (bag,) = (tmp_path / "bags").iterdir()
    wait_for(lambda: newest_on_disk(bag))
    assert main(["replay", str(bag)]) == 2
    assert "is still being recorded" in capsys.readouterr().err
    assert node.stop(signal.SIGINT) == 0
    assert (bag / "metadata.yaml").exists()


@pytest.mark.extended
def test_a_bag_in_several_files_is_one(tmp_path, capsys):
    words = (UNHURRIED, f"record_folder:={tmp_path / 'bags'}", "record_split_duration:=1.0")
    with running_node(tmp_path, *words) as node:
        client = Client(markers=False)
        assert client.spin_until(lambda: client.diagnostics)
        bag = Path(client.record(True).message)
        bridge = start_bridge(tmp_path)
        assert client.spin_until(lambda: len(list(bag.glob("*.mcap"))) > 3), node.text()
        bridge.stop()
        assert client.record(False).success
        assert not client.set_parameter("record_split_size", -1.0).successful
        client.close()
    assert main(["replay", str(bag), *EXACT]) == 0
    assert "repeats" in capsys.readouterr().out
    opens_elsewhere(bag)
    with Reader(bag) as reader:
        assert [file["path"] for file in reader.storage.files] == [
            f"{bag.name}_{n}.mcap" for n in range(len(reader.storage.files))
        ]
        assert sum(file["message_count"] for file in reader.storage.files) == reader.message_count
        profiles = {topic.topic: topic.ext.offered_qos_profiles[0] for topic in reader.connections}
    for name, durability in {"mesh": "TRANSIENT_LOCAL", "markers": "TRANSIENT_LOCAL", "surface": "VOLATILE"}.items():
        assert profiles[f"/tissue_sim/{name}"].durability.name == durability
    assert profiles["/left/servo_cf"].reliability.name == "BEST_EFFORT"
    assert profiles["/tissue_sim/mesh"].reliability.name == "RELIABLE"
