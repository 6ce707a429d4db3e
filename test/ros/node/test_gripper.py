"""A gripper over ROS: its angle opens the jaws, its hand feels their sum, and a bag of it replays."""

import time

import numpy as np
import pytest
from rclpy.qos import qos_profile_sensor_data
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import JointState

from helpers.ros.clients import Client
from helpers.ros.processes import poke_path, running_node, shipped
from tissue_sim.cli import main

RADIUS = 0.003


class Gripper:
    """A client that moves a gripper of the node."""

    def __init__(self, client):
        self.client = client
        self.joint = client.node.create_publisher(JointState, "left/gripper/measured_js", qos_profile_sensor_data)
        self.touch, self.inward = poke_path(shipped(), RADIUS)
        self.turn = Rotation.align_vectors([self.inward], [[0.0, 0.0, 1.0]])[0].as_quat()

    def is_heard(self):
        return self.joint.get_subscription_count() > 0 and self.client.pose.get_subscription_count() > 0

    def hold(self, depth, angle, seconds):
        """Poses and angles at some 250 Hz; the mean force of the last half, (3,) N."""
        self.client.wrenches.clear()
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            message = JointState(name=["jaw"], position=[float(angle)])
            message.header.stamp = self.client.stamp()
            self.joint.publish(message)
            self.client.send_pose(self.touch + depth * self.inward, self.turn)
            self.client.spin(0.004)
        forces = [wrench[:3] for _, wrench in self.client.wrenches]
        return np.mean(forces[len(forces) // 2 :], axis=0) if forces else None


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("gripper")


@pytest.fixture(scope="module")
def node(folder):
    parameters = ("left.shape:=gripper", f"left.radius:={RADIUS}", "left.length:=0.03", f"record_folder:={folder}")
    # A busy machine may hold the poses up, and a tool that comes back inside the organ is held off.
    with running_node(folder, *parameters, "record:=true", "stale_time:=5.0") as process:
        yield process


@pytest.fixture(scope="module")
def client(node):
    made = Client()
    yield made
    made.close()


@pytest.fixture(scope="module")
def gripper(client):
    made = Gripper(client)
    assert client.spin_until(made.is_heard, 10.0)
    return made


def test_angle_that_is_none_is_refused_and_counted(client, node, gripper):
    for message, counter in ((JointState(position=[float("nan")]), "nan_angle"), (JointState(), "no_angle")):

        def is_told(message=message, name=counter):
            gripper.joint.publish(message)
            return f"left.refused.{name}" in client.diagnostics

        assert client.spin_until(is_told, 10.0), client.diagnostics
    assert "tool 'left': angle refused" in node.text()


def test_jaws_that_open_are_felt_and_a_bag_of_it_replays(folder, client, node, gripper):
    # DDS matches both ends, not both at once; a tool first heard inside the organ would be held off.
    assert any(gripper.hold(-0.015, 0.0, 0.1) is not None for _ in range(50)), "poses get no answer"
    for depth in np.linspace(-0.015, 0.004, 60):
        gripper.hold(depth, 0.0, 0.015)
    closed = gripper.hold(0.004, 0.0, 1.0)
    opened = gripper.hold(0.004, 0.5, 1.0)
    assert closed @ gripper.inward < -0.05, client.diagnostics
    assert np.linalg.norm(opened - closed) > 0.02
    assert client.set_parameter("force_clamp", 0.04).successful
    assert np.linalg.norm(gripper.hold(0.004, 0.5, 0.3)) < 0.04 + 1e-6
    assert client.set_parameter("stale_time", 0.3).successful
    # An angle alone doesn't keep a tool in touch whose poses have stopped.
    end = time.monotonic() + 1.0
    while time.monotonic() < end:
        gripper.joint.publish(JointState(position=[0.1]))
        client.spin(0.01)
    assert np.abs(client.wrenches[-1][1]).max() == 0.0
    assert node.stop() == 0
    assert main(["replay", str(next(folder.glob("tissue_sim-*")))]) == 0
