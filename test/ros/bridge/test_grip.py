"""The scripted grip: its path, and the bridge that lifts the kidney of a real node with it."""

import argparse
from typing import NamedTuple

import numpy as np
import pytest
from rclpy.qos import qos_profile_sensor_data
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import JointState, PointCloud2

from helpers.paths import CONFIG
from helpers.ros.clearance import clearance
from helpers.ros.clients import Client
from helpers.ros.node_values import values
from helpers.ros.processes import STAND_IN, UNHURRIED, Process, shipped, start_node
from helpers.ros.stand_in import ball
from tissue_sim.cli import main
from tissue_sim.contact.grasp import at_lower_pole
from tissue_sim.contact.gripper import Jaws
from tissue_sim.errors import UserError
from tissue_sim.ros.bridge import play as bridge
from tissue_sim.ros.bridge.contact_locations import Surface
from tissue_sim.ros.bridge.motion import Path as Motion
from tissue_sim.ros.bridge.player import cast
from tissue_sim.ros.bridge.trajectory import LIFT, plan
from tissue_sim.ros.shared.client import cloud_array

PARAMETERS = CONFIG / "gripper.yaml"
BRIDGE = ["-m", "tissue_sim", "bridge", "--script", "grip"]
JAWS = Jaws(0.0, 0.06)
RATE = 500.0
LIFTED = 0.006  # m, of the fold between the jaws


# the path --------------------------------------------------------------------------------------
@pytest.fixture(scope="module")
def grip() -> Motion:
    return plan(Surface(*ball(), 0.005), ("right",), ("grip",), {"right": JAWS})


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
    path = plan(Surface(*ball(), 0.005), ("probe", "grasper"), ("poke", "grip", "nip"), {"grasper": JAWS})
    poses, angles = path.poses, path.angles
    assert poses[-1] == pytest.approx(poses[0], abs=1e-6)
    assert not angles[:, 0].any()
    assert angles[:, 1].max() > 0.5
    steps = np.linalg.norm(np.diff(poses[:, :, :3], axis=0), axis=2)
    assert steps.max() * RATE < 0.152


def test_what_cannot_be_gripped_is_said():
    with pytest.raises(UserError, match="needs a gripper"):
        plan(Surface(*ball(), 0.005), ("left", "right"), ("grip",))
    with pytest.raises(UserError, match=r"30.* mm wide.*longer jaws"):
        plan(
            Surface(*(part * scale for part, scale in zip(ball(), (1.5, 1), strict=True)), 0.005),
            ("a",),
            ("grip",),
            {"a": Jaws(0.003, 0.012)},
        )


# which tools -----------------------------------------------------------------------------------
def values_of(**shapes):
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
    three = values_of(left="sphere", right="gripper", third="sphere")
    assert chosen(three) == (("left", "right", "third"), ("stroke", "poke", "nip"), {}, 0.003)
    assert chosen(three, "--tools", "third")[:2] == (("third",), ("stroke", "poke"))
    assert chosen(values_of(fd="capsule"), "--radius", "0.004") == (("fd",), ("stroke", "poke"), {}, 0.004)
    assert chosen({}) == (("left", "right"), ("stroke", "poke", "nip"), {}, 0.005)


def test_a_grip_takes_the_nodes_gripper():
    values = values_of(left="sphere", right="gripper")
    jaws = {"right": Jaws(0.003, 0.03)}
    assert chosen(values, "--script", "grip") == (("right",), ("grip",), jaws, 0.003)
    assert chosen(values, "--script", "grip", "--tools", "right,left")[0] == ("right", "left")
    assert chosen(values, "--script", "poke,grip")[0] == ("left", "right")


@pytest.mark.parametrize(
    ("values", "words", "message"),
    [
        (
            values_of(left="sphere"),
            [],
            "on /tissue_sim 'left' is a sphere: start it with --params-file config/gripper.yaml",
        ),
        (values_of(left="gripper"), ["--tools", "right"], "/tissue_sim has no tool 'right'; it has left"),
        ({}, [], "'left' is a sphere, 'right' is a sphere"),
    ],
)
def test_a_node_without_a_gripper_is_reported(values, words, message):
    with pytest.raises(UserError, match=message):
        chosen(values, "--script", "grip", *words)


@pytest.mark.extended
def test_a_node_without_a_gripper_is_one_line_and_exit_code_2(tmp_path, capfd):
    node = Process([STAND_IN], tmp_path / "node.log")
    try:
        node.wait_for("up")
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
        self.newest_lift = 0.0  # m along the direction out
        self.runs: list[Run] = []  # what the jaws did in turn: opened or held
        self._running: Run | None = None  # none while they move
        self.node.destroy_publisher(self.pose)
        self.node.create_subscription(PointCloud2, "/tissue_sim/surface", self._on_surface, qos_profile_sensor_data)
        self.node.create_subscription(JointState, "left/gripper/measured_js", self._on_angle, qos_profile_sensor_data)

    def _on_surface(self, message):
        moved = cloud_array(message)[self.held, :3] - self.rest
        self.newest_lift = float(np.median(moved @ self.grasp.out))
        if self._running is not None:
            self._running.lifts.append(self.newest_lift)

    def _on_wrench(self, message):
        super()._on_wrench(message)
        if self._running is not None:
            self._running.forces.append(self.hand_force())

    def _on_angle(self, message):
        self._running = None
        for name, angle, within in (("opened", self.grasp.opened, 1e-3), ("held", self.grasp.closed, 1e-4)):
            if abs(message.position[0] - angle) < within:
                if not self.runs or self.runs[-1].name != name:
                    self.runs.append(Run(name, [], []))
                self._running = self.runs[-1]

    def grip(self):
        """The newest three runs if jaws that were open have held something, lifted it and released it; else nothing."""
        runs = self.runs[-3:]
        if [run.name for run in runs] != ["opened", "held", "opened"]:
            return None
        lifts = runs[1].lifts
        return runs if len(lifts) > 1 and max(lifts) - lifts[0] > LIFTED else None


class Run(NamedTuple):
    """What was seen while the jaws were open, or while they held something."""

    name: str
    lifts: list[float]  # m
    forces: list[float]  # N, that the hand feels


@pytest.mark.extended
def test_the_bridge_lifts_the_kidney_and_lets_go(tmp_path):
    """It grips again and again; a busy machine may not see every time how the fold between the jaws follows them."""
    node = start_node(tmp_path, UNHURRIED, profile=PARAMETERS)
    watcher = Watcher()
    player = Process(BRIDGE, tmp_path / "bridge.log")
    try:
        player.wait_for("grip in 8.2 s")
        assert watcher.spin_until(watcher.grip), [(run.name, len(run.lifts)) for run in watcher.runs]
        before, during, _ = watcher.grip()
        assert player.stop() == 0, player.text()
        print(
            f"{len(watcher.held)} nodes lifted {1e3 * (max(during.lifts) - during.lifts[0]):.1f} mm, pulled by"
            f" {np.median(during.forces):.2f} N; {player.text().splitlines()[-1]}"
        )
        # They brush the organ on the way out of an earlier grip and on the way into the next one.
        assert np.median(before.forces) == 0.0, "open, they touch nothing"
        assert np.median(during.forces[len(during.forces) // 2 :]) > 0.2, "the hand feels what it lifts"
        assert watcher.set_parameter("stale_time", 0.05).successful
        assert watcher.spin_until(lambda: abs(watcher.newest_lift) < 5e-4), "released"
        assert watcher.spin_until(lambda: np.abs(watcher.wrenches[-1][1]).max() == 0.0)
        assert "Traceback" not in player.text() + node.text()
        assert node.stop() == 0, node.text()
    finally:
        watcher.close()
        for process in (player, node):
            process.child.kill()
