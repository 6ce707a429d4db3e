"""The gripper of config/instruments in a node: its links as markers, moved by the joint that its parameter names."""

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from sensor_msgs.msg import JointState
from visualization_msgs.msg import MarkerArray

from helpers.paths import CONFIG
from helpers.patience import wait_for
from helpers.ros.processes import UNHURRIED
from tissue_sim import read_bag
from tissue_sim.cli import main
from tissue_sim.ros.shared import client
from tissue_sim.ros.shared.qos import STREAM

AWAY = np.array([0.2, 0.1, 0.3])  # m, far from the organ


@pytest.fixture
def node(start, tmp_path):
    recorded = "record:=true", f"record_folder:={tmp_path}/bags"
    return start(tmp_path, UNHURRIED, *recorded, profile=CONFIG / "instruments" / "two_finger.yaml")


def test_links_are_shown_where_the_joint_puts_them_and_a_bag_replays(node, graph, tmp_path):
    poses = graph.create_publisher(PoseStamped, "left/measured_cp", STREAM)
    joints = graph.create_publisher(JointState, "left/gripper/measured_js", STREAM)
    markers = client.NewestMessage(graph, MarkerArray, "/tissue_sim/tools", STREAM)
    pose, joint = PoseStamped(), JointState(name=["elbow", "opening"], position=[0.5, 0.01])
    pose.header.frame_id = "organ"
    pose.pose.position.x, pose.pose.position.y, pose.pose.position.z = AWAY.tolist()

    def shown():
        joints.publish(joint)
        pose.header.stamp = graph.get_clock().now().to_msg()
        poses.publish(pose)
        message = markers.take()
        found = [] if message is None else [one for one in message.markers if one.action == 0 and one.points]
        places = [[one.pose.position.x, one.pose.position.y, one.pose.position.z] - AWAY for one in found[:3]]
        return places if len(places) == 3 and abs(places[1][0] - 0.003) > 1e-6 else None

    palm, finger, opposite = wait_for(shown, node.text)
    assert palm == pytest.approx([0.0, 0.0, -0.052], abs=1e-9)
    assert finger == pytest.approx([0.013, 0.0, -0.02], abs=1e-9)
    assert opposite == pytest.approx([-0.013, 0.0, -0.02], abs=1e-9)

    joint.name[1] = "wrist"

    def refused():
        joints.publish(joint)
        return "angle refused: it contains no position of the joint 'opening'" in node.text()

    wait_for(refused, node.text)

    assert node.stop() == 0, node.text()
    (folder,) = (tmp_path / "bags").iterdir()
    assert main(["replay", str(folder)]) == 0
    angles = read_bag(folder)["left/angle"].values
    assert angles[-1] == 0.01


def test_a_urdf_that_is_not_there_ends_the_node_with_one_line(start, tmp_path):
    process = start(tmp_path, "left.shape:=urdf", "left.mesh:=arm.urdf", wait=False)
    assert process.wait() == 2
    assert "tool 'left': URDF 'arm.urdf' does not exist" in process.text()
    assert "Traceback" not in process.text()
