"""What the node publishes about a tool beside its servo_cf: contact points, its wrench on the organ, its clutch."""

import numpy as np
import pytest
from geometry_msgs.msg import WrenchStamped
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Bool

from helpers.ros.clients import LATCHED, Client
from helpers.ros.processes import UNHURRIED, press_until_contact, running_node
from tissue_sim.ros.node.output.contact_points import COLUMNS
from tissue_sim.ros.shared.client import cloud_array

TURN = Rotation.from_euler("xyz", (40.0, 10.0, 160.0), degrees=True)  # of the hand
RADIUS, DEEPEST = 0.005, 0.003  # m


@pytest.fixture(scope="module")
def node(tmp_path_factory):
    with running_node(tmp_path_factory.mktemp("points"), UNHURRIED, "left.wrench_frame:=body") as process:
        yield process


@pytest.fixture(scope="module")
def client(node):
    client = Client(markers=False)
    client.meet()
    yield client
    client.close()


def ask(client, position):
    client.ask(position, quaternion=TURN.as_quat())


@pytest.fixture
def pressed(client):
    """Where the left tool is, m, that presses the kidney and feels the same from pose to pose."""
    assert client.set_parameter("stale_time", 5.0).successful

    def move(position):
        ask(client, position)
        if client.wrenches:  # press_until_contact looks along the organ's axes
            client.wrenches[-1][1][:3] = TURN.apply(client.wrenches[-1][1][:3])

    position = press_until_contact(client, move, DEEPEST)

    def is_steady():
        ask(client, position)
        newest = [np.linalg.norm(wrench[:3]) for _, wrench in client.wrenches[-20:]]
        return len(newest) == 20 and np.ptp(newest) < 0.01 * np.mean(newest)

    assert client.spin_until(is_steady), client.diagnostics
    return position


def test_contacts_cost_nothing_until_somebody_subscribes_and_add_up_to_the_wrench(client, pressed):
    """In the organ's frame, whatever the axes of the bridge."""
    values = client.report()
    assert (values["contacts_gathered"], values["left.contact_clouds"]) == ("0", "0")
    clouds, wrenches = [], []
    of_cloud = client.node.create_subscription(PointCloud2, "/tissue_sim/left/contacts", clouds.append, 10)
    of_wrench = client.node.create_subscription(WrenchStamped, "/tissue_sim/left/wrench", wrenches.append, 10)

    def is_reported():
        ask(client, pressed)
        return len(clouds) > 3 and len(wrenches) > 3 and len(clouds[-1].data) > 0

    assert client.spin_until(is_reported)
    cloud, wrench = clouds[-1], wrenches[-1].wrench
    assert cloud.header.frame_id == wrenches[-1].header.frame_id == "organ"
    assert tuple(field.name for field in cloud.fields) == COLUMNS
    points = cloud_array(cloud).astype(np.float64)
    places, normals, forces = points[:, :3], points[:, 3:6], points[:, 6:9]
    force = np.array([wrench.force.x, wrench.force.y, wrench.force.z])
    np.testing.assert_allclose(TURN.inv().apply(force), client.wrenches[-1][1][:3], atol=0.02 * np.linalg.norm(force))
    np.testing.assert_allclose(forces.sum(axis=0), force, atol=0.03 * np.linalg.norm(force))
    to_middle = pressed - places
    assert np.linalg.norm(to_middle, axis=1) == pytest.approx(RADIUS, abs=0.002), "less what gives way between nodes"
    to_middle /= np.linalg.norm(to_middle, axis=1)[:, None]
    np.testing.assert_allclose(normals, to_middle, atol=0.01)
    assert (np.einsum("kx,kx->k", forces, normals) > 0.0).all()
    assert not points[:, 9].any(), "the number of the only organ"
    assert client.spin_until(lambda: ask(client, pressed) or int(client.diagnostics["left.contact_clouds"]) > 0)
    assert client.diagnostics["right.contact_clouds"] == "0"

    client.node.destroy_subscription(of_cloud)
    client.node.destroy_subscription(of_wrench)
    found = []

    def is_left_alone():
        found.append(int(client.report()["contacts_gathered"]))
        return len(found) > 1 and found[-1] == found[-2]

    assert client.spin_until(is_left_alone), "it ends with the subscription"


def test_a_tool_that_is_disabled_lets_go_and_is_taken_up_again(client, node, pressed):
    enable = client.node.create_publisher(Bool, "/tissue_sim/left/enable", 10)
    assert client.spin_until(lambda: enable.get_subscription_count() > 0)
    assert client.set_parameter("stale_time", 0.05).successful

    def is_released():
        enable.publish(Bool(data=False))  # DDS matches both ends, not both at once: the first may be lost
        client.send_pose(pressed, quaternion=TURN.as_quat())
        client.spin(0.01)
        return client.hand_force() == 0.0 and client.diagnostics.get("left.state") == "disabled"

    assert client.spin_until(is_released), client.diagnostics
    assert "tool 'left' is disabled: its poses are ignored (~/left/enable)" in node.text()
    poses = int(client.diagnostics["left.poses"])

    def is_taken_up():
        enable.publish(Bool(data=True))
        ask(client, pressed)
        return int(client.diagnostics["left.poses"]) > poses

    assert client.spin_until(is_taken_up)
    assert client.diagnostics["left.state"] != "disabled"


def test_who_comes_late_hears_that_the_node_is_ready(client):
    received = []
    client.node.create_subscription(Bool, "/tissue_sim/ready", received.append, LATCHED)
    assert client.spin_until(lambda: received == [Bool(data=True)])
