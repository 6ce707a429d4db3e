"""The scripted bridge as a process: it moves tools, feels forces, and leaves the tissue when it ends."""

import signal

import numpy as np
import pytest
from geometry_msgs.msg import Point, PoseStamped
from rclpy.qos import qos_profile_sensor_data
from shape_msgs.msg import Mesh

from helpers.exit_codes import exit_code_of
from helpers.ros.clearance import clearance
from helpers.ros.participant import Participant
from helpers.ros.processes import STAND_IN, Process
from helpers.ros.stand_in import ball
from tissue_sim.cli import main
from tissue_sim.ros.bridge.contact_locations import Surface
from tissue_sim.ros.bridge.player import Player
from tissue_sim.ros.bridge.trajectory import plan

BRIDGE = ["-m", "tissue_sim", "bridge"]


HELD_UP = 0.03  # s


class RecordedTool:
    """Takes the place of a tool's topics."""

    name = "left"

    def __init__(self):
        self.poses, self.stamps = [], []

    def publish(self, stamp, pose):
        self.stamps.append(stamp)
        self.poses.append(pose)

    def open(self, stamp, angle):
        assert angle == 0.0, "a tool without jaws"

    def receive(self):
        pass

    def other_publishers(self):
        return 0


class Clock:
    """Takes the place of the module `time`: what is done takes next to no time, and some sleepers are held up."""

    def __init__(self):
        self.now, self.sleeps = 100.0, 0

    def monotonic(self):
        self.now += 1e-6
        return self.now

    def time_ns(self):
        return round(1e9 * self.now)

    def sleep(self, seconds):
        self.sleeps += 1
        self.now += seconds + (HELD_UP if self.sleeps % 20 == 0 else 1e-4)


@pytest.fixture
def clock(monkeypatch):
    """Of the player in this process."""
    made = Clock()
    monkeypatch.setattr("tissue_sim.ros.bridge.player.time", made)
    return made


class NoMesh:
    def take(self):
        return None


@pytest.fixture
def node(tmp_path):
    process = Process([STAND_IN], tmp_path / "node.log")
    process.wait_for("up")
    yield process
    process.stop()


@pytest.mark.parametrize("seconds", [0.3, 1.2])
def test_poses_keep_to_the_path_in_time_and_end_outside(seconds, clock):
    vertices, triangles = ball()
    path = plan(Surface(vertices, triangles, 0.005), rate=200.0)
    tools = [RecordedTool(), RecordedTool()]
    player = Player(tools, seconds)
    player.play(path, False, NoMesh(), vertices)
    assert player.skipped > 0, "the clock holds it up"
    stamps, poses = 1e-9 * np.array(tools[0].stamps), np.array(tools[0].poses)
    assert np.all(np.diff(stamps) > 0.0)
    on_path = stamps - stamps[0] < seconds - 0.02
    errors = [
        np.linalg.norm(pose[:3] - path.poses[round(200.0 * (stamp - stamps[0])), 0, :3])
        for stamp, pose in zip(stamps[on_path], poses[on_path], strict=True)
    ]
    assert np.median(errors) < 0.15 * 0.003  # 3 ms at the highest speed
    steps = np.linalg.norm(np.diff(poses[:, :3], axis=0), axis=1)
    assert np.all(steps <= 0.15 * (np.diff(stamps) + HELD_UP) + 1e-9)  # what was late is left out: no speed of its own
    assert clearance(vertices, triangles, poses[-1, :3]) > 0.01


def test_another_organ_ends_the_path(monkeypatch, clock):
    vertices, triangles = ball()

    class Meshes:
        def take(self):
            return Mesh(vertices=[Point(x=1.0)], triangles=[])

    monkeypatch.setattr("tissue_sim.ros.bridge.player.LOOK_AGAIN", 0.1)
    path = plan(Surface(vertices, triangles, 0.005), rate=200.0)
    tools = [RecordedTool(), RecordedTool()]
    found = Player(tools, 30.0).play(path, False, Meshes(), vertices)
    assert found[0].tolist() == [[1.0, 0.0, 0.0]]
    assert len(tools[0].poses) < 200


@pytest.fixture
def bridge(node, tmp_path):
    process = Process([*BRIDGE, "--script", "stroke"], tmp_path / "bridge.log")
    yield process
    process.child.kill()
    process.child.wait()


def place_of(message):
    """Where a pose is, (3,) m."""
    place = message.pose.position
    return np.array([place.x, place.y, place.z])


def test_it_presses_feels_and_leaves_when_a_signal_ends_it(node, bridge):
    bridge.wait_for("at 500 Hz")
    listener, poses = Participant("listener"), []
    listener.node.create_subscription(PoseStamped, "left/measured_cp", poses.append, qos_profile_sensor_data)
    try:
        assert listener.spin_until(lambda: float(listener.diagnostics.get("left.force_n", 0.0)) > 0.0), "it presses"
        assert listener.spin_until(lambda: len(poses) > 100)
        bridge.child.send_signal(signal.SIGTERM)
        assert listener.spin_until(lambda: bridge.child.poll() is not None)
        assert listener.spin_until(lambda: clearance(*ball(), place_of(poses[-1])) > 0.01), "it ends outside"
    finally:
        listener.close()
    assert bridge.wait() == 0
    assert "Traceback" not in bridge.text()
    last = bridge.text().splitlines()[-1]
    words = last.replace(",", "").split()
    sent, received = int(words[0]), int(words[words.index("wrenches") - 1])
    assert sent > 100, last
    assert received > 0, last
    assert "left 0.50 N, right 0.00 N" in last, last


def test_no_node_is_one_line_and_exit_code_1(capfd):
    assert main(["bridge", "--wait", "0.3", "--node", "nobody"]) == 1
    assert capfd.readouterr().err == (
        "tissue_sim bridge: no answer from /nobody/get_parameters within 0.3 s;"
        " start tissue_node, or name yours with --node\n"
    )


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--rate", "0"], "outside 1..2000 Hz"),
        (["--rate", "fast"], "not a number"),
        (["--tools", "left,left"], "not a valid or unique name"),
        (["--script", "stroke,cut"], "'cut' is unknown"),
        (["--node", "a b"], "not a node name"),
        (["--tools", "left", "--script", "nip"], "two tools"),
    ],
)
def test_wrong_use_is_one_line_and_exit_code_2(words, message, capfd):
    assert exit_code_of("bridge", *words) == 2
    error = capfd.readouterr().err
    assert message in error
    assert error.count("\n") == 1
