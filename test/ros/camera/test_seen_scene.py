"""What a camera sees of an organ that is cut while it runs, of a cut through an inclusion, and of ligaments."""

import itertools

import numpy as np
import pytest
from geometry_msgs.msg import Point
from rclpy.qos import QoSProfile
from sensor_msgs.msg import Image, PointCloud2
from shape_msgs.msg import Mesh, MeshTriangle
from visualization_msgs.msg import Marker, MarkerArray

from helpers.patience import wait_for
from helpers.ros.pictures import LOOKING, POSE, first_hit, pixels, stamp_of
from helpers.ros.processes import UNHURRIED, press_until_contact, running_node, shipped
from helpers.ros.surgeon import DEPTH, Surgeon
from tissue_sim.rendering.offscreen import Offscreen
from tissue_sim.rendering.pinhole import Pinhole, look_at, matrix_of
from tissue_sim.rendering.primitives import ball
from tissue_sim.ros.camera.seen_scene import LIGAMENTS, SeenLigaments, SeenOrgan
from tissue_sim.ros.shared import client
from tissue_sim.ros.shared.qos import LATCHED, STREAM


@pytest.fixture(scope="module")
def node(tmp_path_factory):
    with running_node(tmp_path_factory.mktemp("node"), UNHURRIED):
        yield


def test_an_organ_that_is_cut_while_it_runs_is_seen_with_its_walls(node, graph, begin, listen):
    """A ball presses: the distances in the picture are those of the surface with the walls, at the same time."""
    begin("--name=cut", *LOOKING)
    boxes = listen("camera_info", before="/cut")
    for topic in ("depth/image_raw", "segmentation/image_raw"):  # every one: a busy machine asks seldom
        boxes[topic] = client.NewestMessage(graph, Image, f"/cut/{topic}", QoSProfile(depth=200))
    surgeon = Surgeon()
    try:
        before = pixels(wait_for(boxes["depth/image_raw"].take, "no picture of the uncut organ"))
        answer = surgeon.cut(depth=DEPTH)
        assert answer.success, answer.message
        inside = press_until_contact(surgeon, surgeon.ask, deepest=0.006)
        uncut = len(shipped().surface_triangles)
        assert surgeon.spin_until(lambda: len(surgeon.meshes[-1].triangles) > uncut)
        rest, triangles = client.mesh_arrays(surgeon.meshes[-1])
        pictures, numbers, count = {}, {}, itertools.count()

        def has_moved(cloud):
            return cloud.width == len(rest) and np.abs(client.cloud_array(cloud) - rest).max() > 3e-3

        def seen():
            # It keeps moving: pictures of a surface at rest have later stamps than that.
            surgeon.ask(inside + [5e-4 * np.sin(next(count)), 0.0, 0.0])
            pictures.update({stamp_of(one): one for one in boxes["depth/image_raw"].take_all()})
            numbers.update({stamp_of(one): one for one in boxes["segmentation/image_raw"].take_all()})
            surfaces = {stamp_of(one): one for one in surgeon.clouds if has_moved(one)}
            common = sorted(set(pictures) & set(numbers) & set(surfaces))
            return common and [kind[common[-1]] for kind in (pictures, numbers, surfaces)]

        picture, number, surface = wait_for(seen, "no picture of a surface that came")
        depth, labels, vertices = pixels(picture), pixels(number), client.cloud_array(surface).astype(float)
        k = np.array(wait_for(boxes["camera_info"].take).k).reshape(3, 3)
        matrix, seen_twice = matrix_of(POSE), np.isfinite(before) & (labels == 1)
        for row, column in np.random.default_rng(1).permutation(np.argwhere(labels == 1))[:80]:
            ray = matrix[:3, :3] @ np.linalg.solve(k, [column, row, 1.0])
            expected = first_hit(matrix[:3, 3], ray, vertices, triangles)
            assert depth[row, column] == pytest.approx(expected, abs=1e-4), (row, column)
        assert (np.abs(before - depth)[seen_twice] > 2e-4).sum() > 20, "the ball has moved the tissue"
    finally:
        surgeon.reset()
        surgeon.close()


@pytest.fixture
def drawn():
    with Offscreen(Pinhole.of_view(160, 120, 60.0), samples=1) as made:
        yield made


def test_walls_within_an_inclusion_have_its_colour(graph, drawn):
    """An organ of the size of a ball with a smaller one inside it: what of its surface lies within is coloured."""
    latched = {name: graph.create_publisher(Mesh, f"/seen/{name}", LATCHED) for name in ("mesh", "inclusions")}
    surfaces = graph.create_publisher(PointCloud2, "/seen/surface", STREAM)
    vertices, triangles = ball(0.02)
    organ = SeenOrgan(graph, drawn, "seen", "", 1)
    latched["mesh"].publish(mesh_of(vertices, triangles))
    surface = PointCloud2(width=len(vertices), height=1, point_step=12, data=vertices.astype("<f4").tobytes())
    surface.header.frame_id = "organ"

    def colours():
        surfaces.publish(surface)
        organ.take()
        picture = drawn.take(look_at([0.1, 0.0, 0.0], [0.0, 0.0, 0.0]), labels=True)
        return picture.colour[picture.labels == 1].astype(float)

    wait_for(lambda: len(colours()), "the organ isn't drawn")
    red = colours()
    within, faces = ball(0.01)
    latched["inclusions"].publish(mesh_of(within + [0.02, 0.0, 0.0], faces))  # towards the camera
    wait_for(lambda: 0.05 < pale(colours()) - pale(red) < 0.6, lambda: f"no inclusion: {pale(red)}, {pale(colours())}")
    organ.remove()


def test_ligaments_are_seen_where_they_are_until_they_are_deleted(graph, drawn):
    lines = graph.create_publisher(MarkerArray, "/seen/ligaments", LATCHED)
    ligaments = SeenLigaments(graph, drawn, "seen")
    pose = look_at([0.1, 0.0, 0.0], [0.0, 0.0, 0.0])

    def seen(marker):
        lines.publish(MarkerArray(markers=[marker]))
        ligaments.take()
        return np.argwhere(drawn.take(pose, colour=False, labels=True).labels == LIGAMENTS)

    def marker(*ends):
        made = Marker(type=Marker.LINE_LIST, action=Marker.ADD)
        made.scale.x = 0.002
        made.points = [Point(x=x, y=y, z=z) for x, y, z in ends]
        return made

    one = marker((0.0, -0.02, 0.0), (0.0, 0.02, 0.0))
    wait_for(lambda: len(seen(one)), "no ligament")
    at = seen(one)
    assert np.ptp(at[:, 1]) > 10 * np.ptp(at[:, 0]), "it lies across the picture"
    two = marker((0.0, -0.02, 0.0), (0.0, 0.02, 0.0), (0.0, 0.0, -0.02), (0.0, 0.0, 0.02))
    wait_for(lambda: np.ptp(seen(two)[:, 0]) > 20, "no second one")
    wait_for(lambda: not len(seen(Marker(action=Marker.DELETE))), "they stay")


def pale(colours):
    """Fraction of pixels that are as green as an inclusion is."""
    return np.mean(colours[:, 1] > 0.75 * colours[:, 0])


def mesh_of(vertices, triangles):
    message = Mesh(triangles=[MeshTriangle(vertex_indices=np.array(one, dtype=np.uint32)) for one in triangles])
    message.vertices = [Point(x=x, y=y, z=z) for x, y, z in vertices.tolist()]
    return message
