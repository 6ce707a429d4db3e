"""A node that serves a scene: topics of each organ, what tools feel, a bag that repeats to the last bit."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree
from sensor_msgs.msg import JointState, PointCloud2
from shape_msgs.msg import Mesh
from visualization_msgs.msg import Marker, MarkerArray

from helpers.ros.clients import Client
from helpers.ros.processes import UNHURRIED, Process, running_node, start_node
from helpers.ros.replaying import repeated
from helpers.scenes import ball
from tissue_sim.cli import main
from tissue_sim.ros.bags.comparison import compare
from tissue_sim.ros.bags.player import replay
from tissue_sim.ros.bags.recording import Recording
from tissue_sim.ros.shared import client as beside

SCENE = """
format: 1
organs:
  - {name: liver, file: ball.npz, breathes: 1.0}
  - {name: kidney, file: ball.npz, position: [0.0592, 0.0, 0.0]}
attachments:
  - {between: [liver, kidney], within: 0.01, stiffness: 5.0, damping: 0.01, slack: 0.0}
breathing: {rate: 60, way: [0.0, 0.0, 0.005]}
friction: 0.3
gravity: [0.0, 0.0, -1.0]
"""
TOP = 0.03  # m, of the balls


@pytest.fixture(scope="module")
def scene_file(tmp_path_factory):
    folder = tmp_path_factory.mktemp("scene")
    ball(2).save(folder / "ball.npz")
    path = folder / "two.yaml"
    path.write_text(SCENE)
    return path


@pytest.fixture(scope="module")
def node(scene_file, tmp_path_factory):
    folder = tmp_path_factory.mktemp("node")
    with running_node(
        folder, UNHURRIED, f"scene_file:={scene_file}", f"record_folder:={folder}", "left.radius:=0.005"
    ) as process:
        yield process


@pytest.fixture
def client(node):
    made = Client(markers=False)
    yield made
    made.close()


def received(client, kind, topics, qos):
    """A list for each topic of the node that its messages are added to."""
    lists = {name: [] for name in topics}
    for name, messages in lists.items():
        client.node.create_subscription(kind, f"/tissue_sim/{name}", messages.append, qos)
    return lists


def first(client, messages):
    """The first message of a topic."""
    assert client.spin_until(lambda: messages)
    return messages[0]


def press(client, *wheres, deepest=0.004):
    """Press the tool from above into places (2,) m, one after the other; the largest force, N, at each."""
    peaks = []
    for where in wheres:
        first = len(client.wrenches)
        for height in [*np.linspace(0.012, 0.005 - deepest, 80), *np.linspace(0.005 - deepest, 0.012, 20)]:
            client.ask((*where, TOP + height))
        peaks.append(max(np.linalg.norm(wrench[:3]) for _, wrench in client.wrenches[first:]))
    return peaks


def test_each_organ_has_its_topics_and_all_have_one(node, client):
    assert "organs liver, kidney: 324 surface nodes" in node.text()
    meshes = received(client, Mesh, ["liver/mesh", "kidney/mesh"], beside.latched_qos())
    rest = {name: beside.mesh_arrays(first(client, messages))[0] for name, messages in meshes.items()}
    np.testing.assert_allclose(
        rest["kidney/mesh"] - rest["liver/mesh"], np.tile([0.0592, 0.0, 0.0], (162, 1)), atol=1e-12
    )
    clouds = received(client, PointCloud2, ["liver/surface", "kidney/surface", "liver/skeleton"], beside.stream_qos())
    assert [len(beside.cloud_array(first(client, messages))) for messages in clouds.values()] == [162, 162, 5]
    everything = received(client, MarkerArray, ["markers", "kidney/markers"], beside.latched_qos())
    of_all = first(client, everything["markers"]).markers
    organs = [f"{name}/{part}" for name in ("liver", "kidney") for part in ("surface", "skeleton")]
    assert [marker.ns for marker in of_all] == [*organs, "contacts", "contacts"]
    (own, *_) = first(client, everything["kidney/markers"]).markers
    assert own.ns == "surface"
    assert len(own.points) == len(of_all[2].points)


def test_breathing_is_shown_and_is_no_displacement(client):
    clouds = received(client, PointCloud2, ["liver/surface", "kidney/surface"], beside.stream_qos())

    def span(name):
        heights = [beside.cloud_array(cloud)[:, 2].mean() for cloud in clouds[name]]
        return np.ptp(heights) if len(heights) > 5 else 0.0

    assert client.spin_until(lambda: span("liver/surface") > 0.0035 and clouds["kidney/surface"])
    assert span("kidney/surface") < 0.002, "it only hangs on the other"


def test_ligaments_are_lines_between_the_nodes_that_they_join(client):
    clouds = received(client, PointCloud2, ["liver/surface", "kidney/surface"], beside.stream_qos())
    lines = received(client, MarkerArray, ["ligaments"], beside.latched_qos())["ligaments"]
    assert client.spin_until(lambda: lines and all(clouds.values()))
    (marker,) = lines[-1].markers
    assert (marker.type, marker.header.frame_id) == (Marker.LINE_LIST, "organ")
    ends = np.array([(point.x, point.y, point.z) for point in marker.points]).reshape(-1, 2, 3)
    assert len(ends) > 3
    rest = [ball(2).surface_positions, ball(2).surface_positions + [0.0592, 0.0, 0.0]]
    for side, surface in enumerate(rest):  # the breath moves them by at most 5 mm
        assert cKDTree(surface).query(ends[:, side])[0].max() < 0.006


def test_tools_touch_any_organ_and_the_parameters_tell_their_names(client):
    clouds = received(client, PointCloud2, ["left/contacts"], 10)["left/contacts"]
    # Again where poses were lost before the node had discovered who sends them.
    assert client.spin_until(lambda: min(press(client, (0.0, 0.0), (0.0592, 0.0))) > 0.05), "N"
    assert client.spin_until(lambda: "liver.region" in client.diagnostics)

    def touched(organ):
        """The contact points of an organ that were heard."""
        if not clouds:  # the first may still be on its way
            return []
        points = np.concatenate([beside.cloud_array(cloud) for cloud in clouds])
        return points[points[:, 9] == organ]

    for organ, middle in enumerate((0.0, 0.0592)):
        assert client.spin_until(lambda organ=organ, x=middle: press(client, (x, 0.0)) and len(touched(organ)) > 0)
        own = touched(organ)
        assert np.abs(own[:, 0] - middle).max() < 0.015, "m: where that organ was pressed"
        # By force: a cloud also brings points at the ball's side that press with next to nothing.
        assert np.average(own[:, 5], weights=np.linalg.norm(own[:, 6:9], axis=1)) > 0.5, "from above"
    assert {
        "kidney.contact_count",
        "kidney.skipped.unfelt",
        "pair_searches",
        "skipped.organs_far",
    } <= client.diagnostics.keys()


def test_a_bag_of_a_scene_repeats_to_the_last_bit(client, capsys):
    bag = Path(client.record(True).message)
    press(client, (0.0, 0.0), (0.0592, 0.0), (0.0296, 0.0))
    # Counted from here: a replay begins at the bag's state, and on a stalled machine many surfaces come before that.
    clouds = received(client, PointCloud2, ["liver/surface", "kidney/surface"], beside.stream_qos())
    client.reset()

    def shown():
        """The smallest number of an organ's surfaces that differ: one that stands still is published again."""
        return min(len({bytes(one.data) for one in some}) for some in clouds.values())

    # However long a press takes.
    assert client.spin_until(lambda: press(client, (0.0, 0.0), (0.0592, 0.0)) and shown() > 25)
    assert client.record(False).success
    recording = Recording.read(bag)
    assert recording.config["organs"].keys() == {"liver", "kidney"}
    assert len(recording.joined.fields["links.slack"]) > 0
    replayed = replay(recording)
    found = compare(replayed.wanted, replayed.shown, 0.0, 0.0)
    assert found.passes, [str(one) for one in found.quantities]
    assert found.wrenches > 300
    assert min(len(surfaces) for surfaces in replayed.shown.surfaces) > 20
    assert max(np.abs(wrenches).max() for wrenches in replayed.shown.wrenches if len(wrenches)) > 0.05
    repeated(bag, capsys)
    # Without what joins them it is another scene.
    recording.joined.fields["links.stiffness"] = 0.0 * recording.joined.fields["links.stiffness"]
    replayed = replay(recording)
    assert not compare(replayed.wanted, replayed.shown, 1e-6, 1e-6).passes


@pytest.mark.extended
def test_the_bridge_plays_with_an_organ_that_is_named(node, tmp_path, capfd):
    words = ["bridge", "--seconds", "0.5", "--script", "poke", "--organ"]
    bridge = Process(["-m", "tissue_sim", *words, "kidney"], tmp_path / "bridge.log")
    assert main([*words, "heart"]) == 2
    assert "has no organ 'heart': it serves liver, kidney" in capfd.readouterr().err
    assert bridge.wait() == 0, bridge.text()
    assert "organ of 162 nodes: poke" in bridge.text()


@pytest.mark.extended
def test_a_breath_that_is_published_is_followed_and_refused_where_it_is_none(scene_file, tmp_path):
    path = tmp_path / "followed.yaml"
    path.write_text(SCENE.replace("rate: 60, ", "").replace("ball.npz", str(scene_file.parent / "ball.npz")))
    # In a namespace: the other node of this file is there, too.
    words = UNHURRIED, f"scene_file:={path}", f"record_folder:={tmp_path}"
    process = start_node(tmp_path, *words, remap=("__ns:=/followed",))
    client = Client("/followed", markers=False)
    try:
        clouds: list[PointCloud2] = []
        node = client.node
        node.create_subscription(PointCloud2, "/followed/tissue_sim/liver/surface", clouds.append, beside.stream_qos())
        publisher = node.create_publisher(JointState, "/followed/tissue_sim/respiration", beside.stream_qos())
        seconds = iter(range(1, 10**9))
        started = client.record(True)
        assert started.success, started.message
        bag = next(tmp_path.glob("tissue_sim-*"))

        def tell(*fractions, stamp=None):
            message = JointState(position=list(fractions))
            message.header.stamp.sec = next(seconds) if stamp is None else stamp
            publisher.publish(message)
            return height()

        def height():
            return beside.cloud_array(clouds[-1])[:, 2].mean() if clouds else 0.0025

        assert client.spin_until(lambda: tell(0.8) > 0.00385), height()
        assert client.spin_until(lambda: tell(0.2) < 0.00115), height()
        for wrong in ((), (1.5,), (float("nan"),)):
            name = {(): "no_position", (1.5,): "no_fraction"}.get(wrong, "nan_position")
            key = f"respiration.refused.{name}"
            before = int(client.diagnostics.get(key, 0))
            assert client.spin_until(
                lambda w=wrong, k=key, b=before: tell(*w) and int(client.diagnostics.get(k, 0)) > b
            )
        assert client.spin_until(lambda: tell(0.9, stamp=0) and "respiration.refused.no_stamp" in client.diagnostics)
        assert height() < 0.002, "what is refused moves nothing"
        stopped = client.record(False)
        assert stopped.success, f"{stopped.message}\n{process.text()}"
        assert "a message on ~/respiration was refused: " in process.text()
    finally:
        client.close()
        assert process.stop() == 0, process.text()
    replayed = replay(Recording.read(bag))
    assert compare(replayed.wanted, replayed.shown, 0.0, 0.0).passes
    assert np.ptp([surface[:, 2].mean() for surface in replayed.shown.surfaces[0]]) > 0.002
