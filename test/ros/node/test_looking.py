"""What a viewer gets from the node: at once, coloured, at a cost."""

import json
import re
import signal
from functools import partial

import numpy as np
import pytest
import yaml
from rclpy.qos import qos_profile_sensor_data
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import PointCloud2
from shape_msgs.msg import Mesh
from visualization_msgs.msg import MarkerArray

from helpers.paths import CONFIG
from helpers.ros.clients import LATCHED, Client
from helpers.ros.processes import poke_path, running_node, shipped, start_publisher
from tissue_sim.rendering.appearance import MOVING, SHADES, TISSUE
from tissue_sim.ros.node.output.markers import OrganMarkers
from tissue_sim.ros.shared.client import cloud_array
from tissue_sim.ros.shared.shown_organ import ShownOrgan

pytestmark = pytest.mark.extended


@pytest.fixture(scope="module")
def node(tmp_path_factory):
    with running_node(tmp_path_factory.mktemp("node")) as process:
        yield process


@pytest.fixture
def client(node):
    client = Client(markers=False)
    yield client
    client.close()


def colours_of(message):
    """Colours (corners, 4) of the surface's marker."""
    (surface,) = [marker for marker in message.markers if marker.ns == "surface"]
    assert len(surface.colors) in (0, len(surface.points)), "RViz shows another number as an error"
    return np.array([(c.r, c.g, c.b, c.a) for c in surface.colors]).reshape(-1, 4)


def test_who_comes_late_gets_the_organ_although_nothing_moves(client):
    """Mesh, markers, surface and skeleton of an organ asleep; the second one to come as well as the first."""
    for _ in range(2):
        received = {}
        subscriptions = [
            client.node.create_subscription(kind, f"/tissue_sim/{name}", partial(received.__setitem__, name), qos)
            for name, kind, qos in (
                ("mesh", Mesh, LATCHED),
                ("markers", MarkerArray, LATCHED),
                ("surface", PointCloud2, qos_profile_sensor_data),
                ("skeleton", PointCloud2, qos_profile_sensor_data),
            )
        ]
        assert client.spin_until(lambda h=received: len(h) == 4), received.keys()
        organ = shipped()
        assert np.abs(cloud_array(received["surface"]) - organ.surface_positions).max() < 1e-6
        assert len(received["mesh"].triangles) == len(organ.surface_triangles)
        for subscription in subscriptions:
            client.node.destroy_subscription(subscription)


def test_markers_are_coloured_by_what_is_asked_for(client, tmp_path):
    markers = []  # as bytes: to take each apart would take longer than the next one needs to come
    client.node.create_subscription(MarkerArray, "/tissue_sim/markers", markers.append, LATCHED, raw=True)

    def coloured(colour, is_right):
        """The first colours that are right after such are asked for; nothing has to move."""
        markers.clear()
        assert client.set_parameter("marker_colour", colour).successful
        found = []

        def is_shown():
            if markers:
                found[:] = [colours_of(deserialize_message(markers[-1], MarkerArray))]
                markers.clear()
            return found and is_right(found[0])

        assert client.spin_until(is_shown), colour

    coloured("none", lambda found: len(found) == 0)  # a colour for each corner only when asked
    rest = [*(part / 255.0 for part in TISSUE), 1.0]
    coloured("displacement", lambda found: len(found) and np.allclose(found, rest, atol=1e-6))
    assert client.set_parameter("stale_time", 5.0).successful  # a busy machine may hold these poses up
    publisher = start_publisher(tmp_path, depth=0.004)
    assert client.spin_until(lambda: publisher.says("pressed") and client.hand_force() > 0.1), publisher.text()
    touch, _ = poke_path(shipped())
    away = np.linalg.norm(shipped().surface_positions[shipped().surface_triangles.ravel()] - touch, axis=1)
    red_of_rest = TISSUE[0] / 255.0 + 0.01

    def shows_who_is_pressed(found):
        red = found[:, 0] > red_of_rest
        return len(red) and red[away < 0.012].any() and not red[away > 0.02].any()

    def shows_who_moved(found):
        return len(found) and found[away < 0.01, 0].mean() > found[away > 0.03, 0].mean() + 0.05

    coloured("force", shows_who_is_pressed)
    coloured("displacement", shows_who_moved)
    # All of it moves.
    coloured("region", lambda found: len(found) and np.allclose(found, SHADES[int(MOVING * (len(SHADES) - 1))]))
    coloured("none", lambda found: len(found) == 0)
    assert publisher.stop(signal.SIGTERM) == 0, publisher.text()
    assert not client.set_parameter("marker_colour", "rainbow").successful
    assert client.set_parameter("marker_colour", "displacement").successful


# the files for other viewers -------------------------------------------------------------------
def topics_of_the_node(client):
    """Name and type of every topic and service that the running node has, once they are all known."""
    own = {name: kinds[0] for name, kinds in client.node.get_topic_names_and_types()}
    return own, {name: kinds[0] for name, kinds in client.node.get_service_names_and_types()}


def test_the_rviz_config_shows_what_the_node_publishes(client):
    config = yaml.safe_load((CONFIG / "tissue_sim.rviz").read_text())["Visualization Manager"]
    kinds = {"MarkerArray": "visualization_msgs/msg", "PointCloud2": "sensor_msgs/msg", "Pose": "geometry_msgs/msg"}
    assert config["Global Options"]["Fixed Frame"] == "organ"
    shown = {display["Topic"]["Value"] for display in config["Displays"]}
    assert client.spin_until(lambda: shown <= topics_of_the_node(client)[0].keys()), shown
    topics, _ = topics_of_the_node(client)
    for display in config["Displays"]:
        plugin = display["Class"].rpartition("/")[2]
        topic = display["Topic"]
        assert topics[topic["Value"]] == f"{kinds[plugin]}/{plugin}{'Stamped' * (plugin == 'Pose')}"
        for end in client.node.get_publishers_info_by_topic(topic["Value"]):
            if end.node_name == "tissue_sim":
                assert end.qos_profile.reliability.name == topic["Reliability Policy"].upper().replace(" ", "_")
                assert end.qos_profile.durability.name == topic["Durability Policy"].upper().replace(" ", "_")
    markers = next(display for display in config["Displays"] if display["Class"].endswith("MarkerArray"))
    template = OrganMarkers("organ", {"": ShownOrgan(shipped())}, 2)
    assert set(markers["Namespaces"]) == {m.ns for m in deserialize_message(template.deletion(), MarkerArray).markers}


def test_the_foxglove_layout_shows_what_the_node_publishes(client):
    layout = json.loads((CONFIG / "foxglove.json").read_text())
    panels = layout["configById"]
    named = {*panels["3D!organ"]["topics"], panels["DiagnosticStatusPanel!health"]["topicToRender"]}
    named |= {path["value"].partition(".")[0] for path in panels["Plot!force"]["paths"]}
    called = {panel["serviceName"] for panel in panels.values() if "serviceName" in panel}
    assert client.spin_until(lambda: named <= topics_of_the_node(client)[0].keys()), named
    assert client.spin_until(lambda: called <= topics_of_the_node(client)[1].keys()), called
    placed = re.findall(r"\w+!\w+", json.dumps(layout["layout"]))
    assert sorted(placed) == sorted(panels)
