"""A gripper over ROS: its angle opens the jaws, its hand feels their sum, and a bag of it replays."""

import numpy as np
import pytest
from rclpy.qos import qos_profile_sensor_data
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import JointState

from helpers.ros.clients import Client
from helpers.ros.processes import UNHURRIED, poke_path, running_node, shipped
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

    def hold(self, depth, angle):
        """A pose and an angle, until they are answered or a moment has passed."""
        message = JointState(name=["jaw"], position=[float(angle)])
        message.header.stamp = self.client.stamp()
        self.joint.publish(message)
        self.client.ask(self.touch + depth * self.inward, quaternion=self.turn)

    def pinched(self, depth, angle):
        """The force (3,) N once it has settled; None while it has not been so for 100 answers."""
        self.hold(depth, angle)
        forces = np.array([wrench[:3] for _, wrench in self.client.wrenches[-100:]])
        steady = len(forces) == 100 and np.ptp(np.linalg.norm(forces, axis=1)) < 0.002
        return forces.mean(axis=0) if steady else None

    def settle(self, depth, angle):
        """Hold until the force has settled; what it is then."""
        self.client.wrenches.clear()
        found = []

        def is_settled():
            found[:] = [self.pinched(depth, angle)]
            return found[0] is not None

        assert self.client.spin_until(is_settled), self.client.wrenches[-10:]
        return found[0]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("gripper")


@pytest.fixture(scope="module")
def node(folder):
    parameters = ("left.shape:=gripper", f"left.radius:={RADIUS}", "left.length:=0.03", f"record_folder:={folder}")
    # A busy machine may hold the poses up, and a tool that comes back inside the organ is held off.
    with running_node(folder, *parameters, "record:=true", UNHURRIED) as process:
        yield process


@pytest.fixture(scope="module")
def client(node):
    made = Client()
    yield made
    made.close()


@pytest.fixture(scope="module")
def gripper(client):
    made = Gripper(client)
    assert client.spin_until(made.is_heard)
    return made


@pytest.mark.extended
def test_angle_that_is_none_is_refused_and_counted(client, node, gripper):
    for message, counter in (
        (JointState(position=[float("nan")]), "nan_angle"),
        (JointState(), "no_angle"),
        (JointState(position=[30.0]), "wide_angle"),
        (JointState(position=[-5.0]), "wide_angle"),
    ):
        refused = int(client.diagnostics.get(f"left.refused.{counter}", 0))

        def is_reported(message=message, name=counter, before=refused):
            gripper.joint.publish(message)
            return int(client.diagnostics.get(f"left.refused.{name}", 0)) > before

        assert client.spin_until(is_reported), client.diagnostics
    assert "tool 'left': angle refused" in node.text()
    assert "its angle of 30 rad is outside -2.5..2.5; angles are in radians" in node.text()


def test_jaws_that_open_change_the_force_and_a_bag_of_it_replays(folder, client, node, gripper):
    # DDS matches both ends, not both at once; a tool whose first pose is inside the organ would be held off.
    assert client.spin_until(lambda: gripper.hold(-0.015, 0.0) or client.wrenches), "poses get no answer"
    for depth in np.linspace(-0.015, 0.004, 200):
        gripper.hold(depth, 0.0)
    closed = gripper.settle(0.004, 0.0)
    opened = gripper.settle(0.004, 0.5)
    assert closed @ gripper.inward < -0.05, client.diagnostics
    assert np.linalg.norm(opened - closed) > 0.02
    assert client.set_parameter("force_clamp", 0.04).successful
    assert np.linalg.norm(gripper.settle(0.004, 0.5)) < 0.04 + 1e-6
    assert client.set_parameter("stale_time", 0.3).successful

    def is_released():
        """An angle alone doesn't keep a tool in touch whose poses have stopped."""
        gripper.joint.publish(JointState(position=[0.1]))
        client.spin(0.01)
        return client.hand_force() == 0.0

    assert client.spin_until(is_released)
    assert node.stop() == 0
    assert main(["replay", str(next(folder.glob("tissue_sim-*")))]) == 0
