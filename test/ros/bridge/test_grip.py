"""The scripted grip: its path, and the bridge that lifts the kidney of a real node with it."""

import argparse
import time

import numpy as np
import pytest
from rclpy.qos import qos_profile_sensor_data
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import JointState, PointCloud2

from helpers.paths import CONFIG
from helpers.ros.clearance import clearance
from helpers.ros.clients import Client
from helpers.ros.processes import STAND_IN, UNHURRIED, Process, shipped, start_node
from helpers.ros.stand_in import ball
from helpers.ros.told import values
from tissue_sim.cli import main
from tissue_sim.contact.grasp import at_lower_pole
from tissue_sim.contact.gripper import Jaws
from tissue_sim.errors import UserError
from tissue_sim.ros.bridge import play as bridge
from tissue_sim.ros.bridge.motion import Path as Motion
from tissue_sim.ros.bridge.player import cast
from tissue_sim.ros.bridge.trajectory import LIFT, plan
from tissue_sim.ros.shared.client import cloud_array

PARAMETERS = CONFIG / "gripper.yaml"
BRIDGE = ["-m", "tissue_sim", "bridge", "--script", "grip"]
JAWS = Jaws(0.0, 0.06)
RATE = 500.0


# the path --------------------------------------------------------------------------------------
@pytest.fixture(scope="module")
def grip() -> Motion:
    return plan(*ball(), 0.005, ("right",), ("grip",), {"right": JAWS})


def test_a_grip_comes_opens_closes_lifts_and_lets_go(grip):
    poses, angles, names = grip.poses[:, 0], grip.angles[:, 0], grip.phases
    expected = ["approach", "enter", "close", "lift", "hold", "open", "retreat"]
    assert list(dict.fromkeys(names[1:])) == [*(f"grip/{name}" for name in expected), "return", "pause"]
    assert 5.0 < grip.duration < 10.0
    grasp = at_lower_pole(*ball(), JAWS)
    for name, place, angle in (
        ("close", grasp.place, grasp.opened),
        ("lift", grasp.place, grasp.closed),
        ("hold", grasp.place + LIFT * grasp.out, grasp.closed),
    ):
        first = np.flatnonzero(names == f"grip/{name}")[0]
        assert poses[first, :3] == pytest.approx(place, abs=1e-4)
        assert angles[first] == pytest.approx(angle, abs=1e-3)
    assert angles[0] == 0.0
    assert angles[-1] == 0.0
    assert poses[-1] == pytest.approx(poses[0])
    tips = JAWS.length * np.abs(np.diff(angles)) * RATE / 2.0
    assert tips[names[1:] == "grip/close"].max() < 0.0201, "m/s"
    assert np.abs(np.diff(angles, 2)).max() * RATE**2 * JAWS.length < 5.0, "m/s^2: without a blow"


def test_a_gripper_comes_to_the_organ_with_open_jaws(grip):
    outside = np.isin(grip.phases, ("grip/approach", "return", "pause"))
    assert clearance(*ball(), grip.poses[outside, 0, :3][::20]).min() > 0.005


@pytest.mark.parametrize("phase", ["grip/lift", "grip/hold"])
def test_jaws_open_before_a_retreat(grip, phase):
    step = int(np.median(np.flatnonzero(grip.phases == phase)))
    out = grip.retreat(step)
    poses, angles = out.poses[:, 0], out.angles[:, 0]
    widest = grip.angles.max()
    moving = np.flatnonzero(np.linalg.norm(poses[:, :3] - poses[0, :3], axis=1) > 1e-5)[0]
    assert angles[moving] == pytest.approx(widest, abs=1e-3)
    assert abs(angles[0] - grip.angles[step, 0]) < 0.01
    assert clearance(*ball(), poses[-1, :3]) > 0.01


def test_a_grip_goes_with_other_actions_and_other_tools():
    path = plan(*ball(), 0.005, ("probe", "grasper"), ("poke", "grip", "nip"), {"grasper": JAWS})
    poses, angles = path.poses, path.angles
    assert poses[-1] == pytest.approx(poses[0], abs=1e-6)
    assert not angles[:, 0].any()
    assert angles[:, 1].max() > 0.5
    steps = np.linalg.norm(np.diff(poses[:, :, :3], axis=0), axis=2)
    assert steps.max() * RATE < 0.152


def test_what_cannot_be_gripped_is_said():
    with pytest.raises(UserError, match="needs a gripper"):
        plan(*ball(), 0.005, ("left", "right"), ("grip",))
    with pytest.raises(UserError, match=r"30.* mm wide.*longer jaws"):
        plan(
            *(part * scale for part, scale in zip(ball(), (1.5, 1), strict=True)),
            0.005,
            ("a",),
            ("grip",),
            {"a": Jaws(0.003, 0.012)},
        )


# which tools -----------------------------------------------------------------------------------
def told(**shapes):
    """What a node's parameters say that has tools of some shapes."""
    given = {
        f"{name}__{key}": value
        for name, shape in shapes.items()
        for key, value in (("shape", shape), ("radius", 0.003), ("length", 0.03))
    }
    return values(*shapes, **given)


def chosen(values, *words):
    """Names, script, jaws and radius."""
    parser = argparse.ArgumentParser()
    bridge.add_arguments(parser)
    links, *others = cast(values, parser.parse_args(words))
    return tuple(link.tool.name for link in links), *others


def test_a_bridge_plays_the_nodes_tools():
    three = told(left="sphere", right="gripper", third="sphere")
    assert chosen(three) == (("left", "right", "third"), ("stroke", "poke", "nip"), {}, 0.003)
    assert chosen(three, "--tools", "third")[:2] == (("third",), ("stroke", "poke"))
    assert chosen(told(fd="capsule"), "--radius", "0.004") == (("fd",), ("stroke", "poke"), {}, 0.004)
    assert chosen({}) == (("left", "right"), ("stroke", "poke", "nip"), {}, 0.005)


def test_a_grip_takes_the_nodes_gripper():
    values = told(left="sphere", right="gripper")
    jaws = {"right": Jaws(0.003, 0.03)}
    assert chosen(values, "--script", "grip") == (("right",), ("grip",), jaws, 0.003)
    assert chosen(values, "--script", "grip", "--tools", "right,left")[0] == ("right", "left")
    assert chosen(values, "--script", "poke,grip")[0] == ("left", "right")


@pytest.mark.parametrize(
    ("values", "words", "message"),
    [
        (told(left="sphere"), [], "on /tissue_sim 'left' is a sphere: start it with --params-file config/gripper.yaml"),
        (told(left="gripper"), ["--tools", "right"], "/tissue_sim has no tool 'right'; it has left"),
        ({}, [], "'left' is a sphere, 'right' is a sphere"),
    ],
)
def test_a_node_without_a_gripper_is_told(values, words, message):
    with pytest.raises(UserError, match=message):
        chosen(values, "--script", "grip", *words)


def test_a_node_without_a_gripper_is_one_line_and_exit_code_2(tmp_path, capfd):
    node = Process([STAND_IN], tmp_path / "node.log")
    try:
        node.wait_for("up", 20.0)
        assert main(["bridge", "--script", "grip"]) == 2
    finally:
        node.stop()
    error = capfd.readouterr().err
    assert "a grip needs a gripper" in error
    assert error.count("\n") == 1


# the node --------------------------------------------------------------------------------------
class Watcher(Client):
    """Follows how far the fold between the jaws is lifted."""

    def __init__(self):
        super().__init__(markers=False)
        organ = shipped()
        self.grasp = at_lower_pole(organ.surface_positions, organ.surface_triangles, JAWS)
        # What the pads cover: 16 mm wide, from their tips to where the pole ends.
        x, y, z = Rotation.from_quat(self.grasp.turn).inv().apply(organ.surface_positions - self.grasp.place).T
        self.held = np.flatnonzero((np.abs(x) > 0.01) & (np.abs(y) < 0.008) & (z < 0.0))
        self.rest = organ.surface_positions[self.held]
        self.lifts: list[tuple[float, float]] = []  # s, m along the way out
        self.jaws: list[list] = []  # what they were in turn: opened or held, s from, s until
        self.node.destroy_publisher(self.pose)
        self.node.create_subscription(PointCloud2, "/tissue_sim/surface", self._on_surface, qos_profile_sensor_data)
        self.node.create_subscription(JointState, "left/gripper/measured_js", self._on_angle, qos_profile_sensor_data)

    def _on_surface(self, message):
        moved = cloud_array(message)[self.held, :3] - self.rest
        self.lifts.append((time.monotonic(), float(np.median(moved @ self.grasp.out))))

    def _on_angle(self, message):
        now = time.monotonic()
        for name, angle, within in (("opened", self.grasp.opened, 1e-3), ("held", self.grasp.closed, 1e-4)):
            if abs(message.position[0] - angle) < within:
                if not self.jaws or self.jaws[-1][0] != name:
                    self.jaws.append([name, now, now])
                self.jaws[-1][2] = now

    def saw_a_grip(self):
        """True after jaws that were open have held something and let go."""
        return [name for name, _, _ in self.jaws[-3:]] == ["opened", "held", "opened"]

    def lift(self):
        return self.lifts[-1][1] if self.lifts else 0.0

    def felt(self, start, end):
        return [np.linalg.norm(wrench[:3]) for at, wrench in self.wrenches if start < at < end]


def test_the_bridge_lifts_the_kidney_and_lets_go(tmp_path):
    node = start_node(tmp_path, UNHURRIED, profile=PARAMETERS)
    watcher = Watcher()
    player = Process(BRIDGE, tmp_path / "bridge.log")
    try:
        player.wait_for("grip in 8.2 s", 30.0)
        assert watcher.spin_until(watcher.saw_a_grip, 60.0), watcher.jaws
        (_, _, came), (_, held, parted), _ = watcher.jaws[-3:]
        assert player.stop() == 0, player.text()
        watcher.spin(1.5)
        lifts = np.array(watcher.lifts)
        level = np.interp([held, parted - 0.1], *lifts.T)  # as the jaws have closed, and at the end of the hold
        during = watcher.felt(parted - 0.8, parted)
        print(
            f"{len(watcher.held)} nodes lifted {1e3 * np.ptp(level):.1f} mm, pulled by {np.median(during):.2f} N,"
            f" then {1e3 * watcher.lift():.2f} mm; {player.text().splitlines()[-1]}"
        )
        assert level[1] - level[0] > 0.006, watcher.diagnostics
        assert not any(watcher.felt(came - 1.0, came)), "open, they touch nothing"
        assert np.median(during) > 0.2, "the hand feels what it lifts"
        assert abs(watcher.lift()) < 5e-4, "let go"
        assert np.abs(watcher.wrenches[-1][1]).max() == 0.0
        assert "Traceback" not in player.text() + node.text()
        assert node.stop() == 0, node.text()
    finally:
        watcher.close()
        for process in (player, node):
            process.child.kill()
