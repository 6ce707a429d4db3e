"""The viewer holds a node's tools as their bridges would: every type, without a browser."""

import numpy as np
import pytest
import rclpy
from geometry_msgs.msg import Pose, PoseStamped, TransformStamped
from nav_msgs.msg import Odometry
from scipy.spatial.transform import Rotation

from helpers.patience import wait_for
from helpers.ros.participant import Participant
from helpers.ros.processes import STAND_IN, UNHURRIED, Process, running_node
from tissue_sim.contact.tools import Tool
from tissue_sim.ros.shared.frames import Transform
from tissue_sim.ros.shared.node_parameters import NodeParameters
from tissue_sim.ros.shared.tool_link import PoseWriter, ToolLink
from tissue_sim.ros.shared.tool_messages import N_POSE, POSE_TYPES
from tissue_sim.ros.viewer.poked_tool import PokedTool

pytest.importorskip("viser")
from helpers.ros.node_values import values


# what goes out ---------------------------------------------------------------------------------
@pytest.mark.parametrize("kind", [PoseStamped, Pose, TransformStamped, Odometry])
def test_poses_of_every_type_come_back_as_they_were(kind):
    base = Rotation.from_euler("xyz", [0.4, -1.0, 2.0])
    given = values(
        left__pose_type=kind.__name__,
        left__frame_id="arm",
        left__base_pose=[0.1, -0.2, 0.3, *base.as_quat()],
        base_frame="world",
        organ_pose=[0.5, 0.1, -0.2, 0.0, 0.0, 0.6, 0.8],
        left__motion_scale=0.25,
    )
    link = ToolLink.from_parameters(given, "left", "tissue_sim")
    pose = np.array([0.03, 0.02, -0.04, *Rotation.from_euler("xyz", [0.1, 0.2, 0.3]).as_quat()])
    raw = PoseWriter(link).message(1_500_000_000, pose)
    read = POSE_TYPES[kind.__name__].parse(raw, N_POSE)
    assert (read.stamp, read.frame_id) == ((-1, "") if kind is Pose else (1_500_000_000, "arm"))
    assert link.to_organ.of(read.values) == pytest.approx(pose)
    assert link.to_organ.scale == 0.25


def test_a_link_has_the_nodes_names_and_qos():
    given = values(left__measured_cp="/MTML/measured_cp", left__measured_js="~/jaw", left__reliable=True)
    link = ToolLink.from_parameters(given | {"left.shape": "gripper"}, "left", "ward/tissue_sim")
    assert link.topics.names["measured_cp"] == "/MTML/measured_cp"
    assert link.topics.names["measured_js"] == "/ward/tissue_sim/jaw"
    assert link.qos.reliability == rclpy.qos.ReliabilityPolicy.RELIABLE
    assert link.tool == Tool("left", "gripper")
    assert ToolLink.from_parameters(given, "right", "tissue_sim") is None
    assert ToolLink.from_parameters({}, "left", "tissue_sim") is None


# over ROS --------------------------------------------------------------------------------------
@pytest.mark.extended
def test_a_node_without_these_parameters_tells_none(tmp_path, graph):
    node = Process([STAND_IN], tmp_path / "node.log")
    reader = NodeParameters(graph, "tissue_sim")
    try:
        node.wait_for("up")
        assert wait_for(lambda: [found for found in [reader.poll()] if found is not None]) == [{}]
        assert reader.poll() is None
        reader.ask()
        assert wait_for(lambda: [found for found in [reader.poll()] if found is not None]) == [{}]
    finally:
        node.stop()


# a node and the viewer -------------------------------------------------------------------------
KINDS = ("Pose", "TransformStamped", "Odometry")


@pytest.fixture(scope="module")
def node(tmp_path_factory):
    """A node with a tool of each type, all in a frame that is turned."""
    turned = ("base_pose:=[0.2, -0.3, 0.1, 0.6, 0.0, 0.0, 0.8]", "frame_id:=arm", "motion_scale:=0.5")
    words = [f"{kind}.{word}" for kind in KINDS for word in (f"pose_type:={kind}", "wrench_frame:=body", *turned)]
    folder = tmp_path_factory.mktemp("types")
    with running_node(folder, UNHURRIED, f"tools:=[{', '.join(KINDS)}]", "base_frame:=world", *words) as process:
        yield process
        assert "refused" not in process.text()


# One of them shows that the page holds a tool in a frame that is turned; that poses of every type come back, is above.
@pytest.mark.extended
@pytest.mark.parametrize("kind", [KINDS[0], *(pytest.param(kind, marks=pytest.mark.extended) for kind in KINDS[1:])])
def test_a_tool_of_any_type_can_be_poked_with(kind, node, open_page):
    open_page(kind).press_and_release()


@pytest.mark.extended
def test_an_organ_that_is_registered_anew_is_poked_where_it_is_now(node, open_page):
    page, participant = open_page(KINDS[0]), Participant("surgeon")

    def to_organ() -> Transform | None:
        return page.poke._tool._link.to_organ if page.poke._tool._link is not None else None

    try:
        assert page.wait(lambda: to_organ() is not None)
        before = to_organ()
        assert participant.set_parameter("organ_pose", [0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 1.0]).successful
        assert page.wait(lambda: to_organ() != before)
        assert to_organ().translation[2] == pytest.approx(before.translation[2] - 0.1)
    finally:
        participant.set_parameter("organ_pose", [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
        participant.close()


@pytest.mark.extended
def test_another_frame_has_the_tool_released(graph):
    tool = PokedTool(graph, "left")
    link = ToolLink.from_parameters(values(), "left", "tissue_sim")
    tool.use(link)
    tool.take(np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]), "organ")
    tool.use(ToolLink.from_parameters(values(), "left", "tissue_sim"))
    assert tool.held, "the same"
    tool.use(ToolLink(link.topics, Transform((0.1, 0.0, 0.0)), link.tool))
    assert not tool.held
