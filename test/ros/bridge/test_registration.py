"""A bridge that plays goes on at the organ's new place where that is registered again: real processes."""

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from rclpy.qos import qos_profile_sensor_data
from scipy.spatial.transform import Rotation

from helpers.ros.participant import Participant
from helpers.ros.processes import UNHURRIED, Process, running_node, shipped

OFFSET, TURN = np.array([1.0, -0.5, 0.2]), Rotation.from_euler("z", 90.0, degrees=True)


@pytest.mark.extended
def test_it_follows_an_organ_pose_that_changes(tmp_path):
    listener, poses = Participant("listener"), []
    listener.node.create_subscription(PoseStamped, "left/measured_cp", poses.append, qos_profile_sensor_data)
    words = "tools:=[left]", UNHURRIED, "base_frame:=world", "left.frame_id:=world"
    low, high = shipped().rest_positions.min(axis=0) - 0.05, shipped().rest_positions.max(axis=0) + 0.05

    def presses(offset, turn):
        """Whether the newest pose is beside the organ there, and there is a force."""
        if not poses or float(listener.diagnostics.get("left.force_n", 0.0)) == 0.0:
            return False
        place = poses[-1].pose.position
        own = turn.inv().apply(np.array([place.x, place.y, place.z]) - offset)
        return bool(np.all((low < own) & (own < high)))

    try:
        with running_node(tmp_path, *words):
            bridge = Process(["-m", "tissue_sim", "bridge", "--script", "stroke"], tmp_path / "bridge.log")
            assert listener.spin_until(lambda: presses(np.zeros(3), Rotation.identity())), bridge.text()
            assert listener.set_parameter("organ_pose", [*OFFSET, *TURN.as_quat()]).successful
            listener.report()  # of a moment when the bridge may not know yet
            assert listener.spin_until(lambda: presses(OFFSET, TURN)), bridge.text()
            assert bridge.stop() == 0, bridge.text()
        assert poses[-1].header.frame_id == "world"
    finally:
        listener.close()
