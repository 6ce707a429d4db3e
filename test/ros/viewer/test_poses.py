"""The viewer holds a node's tools as their bridges would: every profile, every type, without a browser."""

import time

import numpy as np
import pytest
import rclpy
from geometry_msgs.msg import Pose, PoseStamped, TransformStamped
from nav_msgs.msg import Odometry
from ruamel.yaml import YAML
from scipy.spatial.transform import Rotation

from helpers.ros.processes import STAND_IN, UNHURRIED, Process, shipped, start_node
from tissue_sim.contact.tools import Tool
from tissue_sim.ros.shared.frames import Transform
from tissue_sim.ros.shared.node_parameters import NodeParameters
from tissue_sim.ros.shared.tool_link import PoseWriter, ToolLink
from tissue_sim.ros.shared.tool_messages import N_POSE, POSE_TYPES
from tissue_sim.ros.viewer.held_tool import HeldTool

pytest.importorskip("viser")
from helpers.paths import CONFIG
from helpers.ros.told import values
from tissue_sim.ros.viewer.poke import beside

PROFILES = {path.stem: path for path in sorted((CONFIG / "bridges").glob("*.yaml"))}


# what goes out ---------------------------------------------------------------------------------
@pytest.mark.parametrize("kind", [PoseStamped, Pose, TransformStamped, Odometry])
def test_poses_of_every_type_come_back_as_they_were(kind):
    base = Rotation.from_euler("xyz", [0.4, -1.0, 2.0])
    told = values(
        left__pose_type=kind.__name__,
        left__frame_id="arm",
        left__base_pose=[0.1, -0.2, 0.3, *base.as_quat()],
        base_frame="world",
        organ_pose=[0.5, 0.1, -0.2, 0.0, 0.0, 0.6, 0.8],
        left__motion_scale=0.25,
    )
    link = ToolLink.told(told, "left", "tissue_sim")
    pose = np.array([0.03, 0.02, -0.04, *Rotation.from_euler("xyz", [0.1, 0.2, 0.3]).as_quat()])
    raw = PoseWriter(link).message(1_500_000_000, pose)
    read = POSE_TYPES[kind.__name__].parse(raw, N_POSE)
    assert (read.stamp, read.frame_id) == ((-1, "") if kind is Pose else (1_500_000_000, "arm"))
    assert link.to_organ.of(read.values) == pytest.approx(pose)
    assert link.to_organ.scale == 0.25


def test_a_link_has_the_nodes_names_and_qos():
    told = values(left__measured_cp="/MTML/measured_cp", left__measured_js="~/jaw", left__reliable=True)
    link = ToolLink.told(told | {"left.shape": "gripper"}, "left", "ward/tissue_sim")
    assert link.topics.names["measured_cp"] == "/MTML/measured_cp"
    assert link.topics.names["measured_js"] == "/ward/tissue_sim/jaw"
    assert link.qos.reliability == rclpy.qos.ReliabilityPolicy.RELIABLE
    assert link.tool == Tool("left", "gripper")
    assert ToolLink.told(told, "right", "tissue_sim") is None
    assert ToolLink.told({}, "left", "tissue_sim") is None


# over ROS --------------------------------------------------------------------------------------
def test_a_node_without_these_parameters_tells_none(tmp_path, graph):
    node = Process([STAND_IN], tmp_path / "node.log")
    reader = NodeParameters("tissue_sim")
    try:
        node.wait_for("up", 20.0)
        assert wait_for(reader.poll, 20.0) == {}
        assert reader.poll() is None
        reader.ask()
        assert wait_for(reader.poll, 20.0) == {}
    finally:
        node.stop()


def wait_for(answer, timeout):
    end = time.monotonic() + timeout
    while (found := answer()) is None and time.monotonic() < end:
        time.sleep(0.01)
    return found


# a node and the viewer -------------------------------------------------------------------------
def poke(page, node):
    """Take the tool in hand, press the organ, let go."""
    assert page.wait(lambda: not page.poke._box.disabled, 30.0), node.text()
    page.tick(True)
    assert page.wait(lambda: page.poke._tool.held and page.view.force is not None, 20.0), node.text()
    assert page.force() == 0.0, "taken in hand outside the organ"
    assert not page.poke._warning.visible
    position, inward = beside(shipped().surface_positions, 0, page.view.reach)
    for depth in np.linspace(0.0, 0.024, 60):
        page.drag(position + depth * inward)
        if page.wait(lambda: page.force() > 0.1, 0.03):
            break
    assert page.force() > 0.1, node.text()
    page.tick(False)
    assert page.wait(lambda: page.force() == 0.0, 10.0)


@pytest.mark.parametrize("name", PROFILES)
def test_a_tool_of_every_profile_can_be_poked_with(name, tmp_path, open_page):
    tool = YAML(typ="safe").load(PROFILES[name].read_text())["/**"]["ros__parameters"]["tools"][0]
    node = start_node(tmp_path, UNHURRIED, profile=PROFILES[name])
    try:
        page = open_page(tool)
        poke(page, node)
        assert page.poke._tool.topic in page.poke._box.hint
        assert not page.poke.jaws._slider.visible
        assert node.stop() == 0, node.text()
        assert "refused" not in node.text()
    finally:
        node.child.kill()


@pytest.mark.parametrize("kind", ["Pose", "TransformStamped", "Odometry"])
def test_a_tool_of_any_type_can_be_poked_with(kind, tmp_path, open_page):
    turned = ["left.base_pose:=[0.2, -0.3, 0.1, 0.6, 0.0, 0.0, 0.8]", "base_frame:=world", "left.frame_id:=arm"]
    words = [UNHURRIED, f"left.pose_type:={kind}", *turned, "left.motion_scale:=0.5"]
    node = start_node(tmp_path, *words, profile=PROFILES["dvrk"])
    try:
        poke(open_page("left"), node)
        assert node.stop() == 0, node.text()
        assert "refused" not in node.text()
    finally:
        node.child.kill()


def test_another_frame_has_the_tool_let_go(graph):
    tool = HeldTool(graph, "left")
    link = ToolLink.told(values(), "left", "tissue_sim")
    tool.use(link)
    tool.take(np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]), "organ")
    tool.use(ToolLink.told(values(), "left", "tissue_sim"))
    assert tool.held, "the same"
    tool.use(ToolLink(link.topics, Transform((0.1, 0.0, 0.0)), link.tool))
    assert not tool.held
