"""Contact sets: which points of the surface a tool may touch, and what is left out."""

import os

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from helpers.scenes import RADIUS, ball, kidney
from tissue_sim.contact.contact_lattice import divisions_of, edge_and_face_points
from tissue_sim.contact.finder import TIP_REACH, TISSUE_MOTION, ContactFinder, ContactQuery
from tissue_sim.contact.local_compliance import OF_OTHERS, local_compliance, max_yielding
from tissue_sim.contact.reach_margins import reach_margins
from tissue_sim.contact.scene import Scene
from tissue_sim.contact.tools import MARGIN, Tool, ToolSet
from tissue_sim.model.data.contact_set import MAX_CONTACT_POINTS, Engaged
from tissue_sim.ros.probes.soak_monitor import resident

STILL = (0.0, 0.0, 0.0, 1.0)


def make_finder(organ, *tools):
    return ContactFinder(organ, ToolSet(list(tools)))


def find(finder, organ, *poses, engaged=None, pushing=None, margins=None, positions=None):
    n_bodies = len(poses)
    query = ContactQuery(
        np.array(poses),
        np.zeros(n_bodies) if margins is None else np.array(margins),
        np.ones(n_bodies, dtype=np.int64) if engaged is None else np.array(engaged),
        np.zeros(n_bodies, dtype=np.int64) if pushing is None else np.array(pushing),
        np.zeros(n_bodies, dtype=np.int64),
    )
    return finder.find(organ.rest_positions if positions is None else positions, query)


def over(organ, direction, gap, radius=0.0):
    """A pose outside the outermost surface node in a direction, gap and radius away."""
    direction = np.array(direction) / np.linalg.norm(direction)
    node = np.argmax(organ.surface_positions @ direction)
    return np.array([*(organ.surface_positions[node] + (gap + radius) * direction), *STILL])


def points_of(found, position):
    return np.einsum("ij,ijk->ik", found.weight, position[found.node])


def check_entries(found, organ):
    assert found.node.shape == found.weight.shape == (len(found.body), 4)
    assert found.normal.shape == (len(found.body), 3)
    # In an uncut organ a point lies in a triangle.
    np.testing.assert_array_equal(found.node[:, 3], found.node[:, 0])
    np.testing.assert_array_equal(found.weight[:, 3], 0.0)
    np.testing.assert_allclose(found.weight.sum(axis=1), 1.0, atol=1e-12)
    assert np.all(found.weight >= 0.0)
    assert np.all((found.node >= 0) & (found.node < organ.n_surface))
    np.testing.assert_allclose(np.linalg.norm(found.normal, axis=1), 1.0, atol=1e-12)


def test_far_tool_gives_an_empty_set_and_counts_the_skip():
    organ = kidney()
    finder = make_finder(organ, Tool("left", radius=0.005))
    found = find(finder, organ, [1.0, 0.0, 0.0, *STILL])
    assert len(found.body) == len(found.node) == len(found.weight) == len(found.normal) == 0
    np.testing.assert_array_equal(found.tip_node, [[-1, -1, -1, -1]])
    assert (finder.counters.sets, finder.counters.far_skips, finder.counters.narrow_phases) == (1, 1, 0)


def test_tool_within_the_organs_box_but_far_from_its_triangles_is_skipped_too():
    organ = ball(2)
    finder = make_finder(organ, Tool("left", radius=0.002))
    found = find(finder, organ, [*[0.9 * RADIUS] * 3, *STILL])
    assert len(found.body) == 0
    assert (finder.counters.far_skips, finder.counters.narrow_phases) == (1, 0)


@pytest.mark.parametrize("organ", [ball(1), ball(2), kidney()], ids=["coarse", "fine", "kidney"])
@pytest.mark.parametrize(
    "tool", [Tool("left", radius=0.006), Tool("left", "capsule", radius=0.003, length=0.05)], ids=["sphere", "capsule"]
)
def test_every_entry_is_a_point_of_a_triangle_near_the_tool(organ, tool):
    finder = make_finder(organ, tool)
    found = find(finder, organ, over(organ, (0.2, 0.1, 1.0), 0.0, tool.radius))
    assert len(found.body) > 3
    check_entries(found, organ)
    assert finder.counters.narrow_phases == 1
    triangles = {tuple(sorted(t)) for t in organ.surface_triangles.tolist()}
    for nodes in found.node[:, :3]:
        assert len(set(nodes)) == 1 or tuple(sorted(nodes.tolist())) in triangles
    assert found.header.dropped == 0
    twice = {tuple(np.round(point, 12)) for point in points_of(found, organ.rest_positions)}
    assert len(twice) == len(found.body), "a point occurs twice"


@pytest.mark.parametrize("organ", [ball(2), kidney()], ids=["ball", "kidney"])
def test_every_node_within_the_margin_is_an_entry(organ):
    finder = make_finder(organ, Tool("left", radius=0.006), Tool("right", radius=0.003))
    left, right = over(organ, (0.2, 0.1, 1.0), 0.0, 0.006), over(organ, (1.0, 0.1, 0.3), 0.001, 0.003)
    found = find(finder, organ, left, right)
    check_entries(found, organ)
    assert np.all(np.diff(found.body) >= 0)
    for tool, pose, radius in ((0, left, 0.006), (1, right, 0.003)):
        distance = np.linalg.norm(organ.surface_positions - pose[:3], axis=1) - radius
        corner = (found.body == tool) & (found.node[:, 0] == found.node[:, 1])
        assert set(np.flatnonzero(distance < MARGIN)) <= set(found.node[corner, 0])
    # What a fast tool may reach until the next set.
    wide = find(finder, organ, left, right, margins=[0.004, 0.0])
    distance = np.linalg.norm(organ.surface_positions - left[:3], axis=1) - 0.006
    assert set(np.flatnonzero(distance < MARGIN + 0.004)) <= set(wide.node[wide.body == 0, 0])
    assert np.count_nonzero(wide.body == 1) == np.count_nonzero(found.body == 1)


@pytest.mark.parametrize("radius", [0.004, 0.002])
def test_points_lie_dense_enough_that_the_tool_does_not_fit_between_them(radius):
    """Over the middle of a triangle five tool radii long, some point is nearer than the tool's radius."""
    organ = ball(1)
    finder = make_finder(organ, Tool("left", radius=radius))
    for triangle in organ.surface_triangles[::7]:
        for weight in ([1 / 3, 1 / 3, 1 / 3], [0.5, 0.5, 0.0], [0.6, 0.3, 0.1], [0.2, 0.2, 0.6]):
            point = weight @ organ.surface_positions[triangle]
            found = find(finder, organ, [*point, *STILL])
            distance = np.linalg.norm(points_of(found, organ.rest_positions) - point, axis=1)
            assert distance.min() < 0.75 * radius


def test_normals_point_outward():
    organ = ball(2)
    found = find(make_finder(organ, Tool("left", radius=0.006)), organ, over(organ, (0.0, 0.3, 1.0), 0.0, 0.006))
    points = points_of(found, organ.rest_positions)
    assert np.einsum("ij,ij->i", found.normal, points).min() > 0.95 * RADIUS
    # Also at the rim, where some of a node's triangles lie beyond the tool's box.
    mesh = trimesh.Trimesh(organ.surface_positions, organ.surface_triangles, process=False)
    corner = found.node[:, 0] == found.node[:, 1]
    near = np.einsum("ij,ij->i", found.normal[corner], mesh.vertex_normals[found.node[corner, 0]])
    assert near.min() > 0.95


@pytest.mark.parametrize("gap", [-0.001, 0.5 * MARGIN, 0.9 * MARGIN])
def test_flat_tool_over_the_middle_of_a_triangle_has_points_in_it(tmp_path, gap):
    """A small box turned flat to a triangle, no corner of the triangle anywhere near it."""
    organ = ball(1)
    box = trimesh.creation.box((0.004, 0.004, 0.004))
    box.apply_translation([0.0, 0.0, -0.002])
    box.export(tmp_path / "box.stl")
    finder = make_finder(organ, Tool("left", "mesh", mesh=str(tmp_path / "box.stl")))
    for number in range(0, len(organ.surface_triangles), 9):
        triangle = organ.surface_triangles[number]
        a, b, c = organ.surface_positions[triangle]
        normal = np.cross(b - a, c - a)
        normal /= np.linalg.norm(normal)
        turn, _ = Rotation.align_vectors([-normal], [[0.0, 0.0, 1.0]])
        middle = (a + b + c) / 3.0
        found = find(finder, organ, [*(middle + gap * normal), *turn.as_quat()])
        inside = np.all(np.sort(found.node[:, :3], axis=1) == np.sort(triangle), axis=1)
        assert inside.any(), f"triangle {number}"


def on_a_jaw(folder):
    """The ball, the longest edge of each triangle, half a jaw's thickness, and the points that it touches.

    Some triangles get 2 parts, and no point in their inside, the others 3, and one.
    """
    organ = ball(2)
    corner = organ.surface_positions[organ.surface_triangles]
    longest = np.linalg.norm(corner - np.roll(corner, 1, axis=1), axis=2).max(axis=1)
    radius = 0.5 * float(longest.min() + longest.max()) / (2.0 * OF_OTHERS.spacing)
    trimesh.creation.box((0.06, 0.06, 2.0 * radius)).export(folder / "jaw.stl")
    finder = make_finder(organ, Tool("left", shape="mesh", mesh=str(folder / "jaw.stl")))
    found = find(finder, organ, over(organ, (0.0, 0.0, 1.0), radius), margins=[0.1])
    return organ, longest, radius, found


def test_a_jaw_finds_points_as_close_together_as_each_triangle_asks_for(tmp_path):
    """And all that lies on a triangle gives way as a foundation of its area."""
    organ, longest, radius, found = on_a_jaw(tmp_path)
    assert found.header.dropped == 0
    inner = np.count_nonzero(found.weight > 0.0, axis=1) == 3
    assert 0 < np.count_nonzero(inner) < len(longest)
    local = local_compliance(organ, radius)
    for triangle, edge in zip(organ.surface_triangles, longest, strict=True):
        m = divisions_of(edge / (OF_OTHERS.spacing * radius))
        rows = np.flatnonzero(inner & (np.sort(found.node[:, :3], axis=1) == np.sort(triangle)).all(axis=1))
        assert len(rows) == (m - 1) * (m - 2) // 2
        wanted = m**2 * np.einsum("kc,kcx->kx", found.weight[rows], local[found.node[rows]])
        np.testing.assert_allclose(found.compliance[rows], wanted)


def test_tissue_gives_way_to_a_jaw_as_far_as_the_points_around_lie_close_not_as_those_of_the_coarsest_triangle(
    tmp_path,
):
    organ, longest, radius, found = on_a_jaw(tmp_path)
    parts = np.array([divisions_of(edge / (OF_OTHERS.spacing * radius)) for edge in longest])
    own = max_yielding(OF_OTHERS, organ, radius, longest / parts)
    assert own.max() > 1.5 * own.min()
    inner = np.count_nonzero(found.weight > 0.0, axis=1) == 3
    for triangle, room in zip(organ.surface_triangles, own, strict=True):
        rows = inner & (np.sort(found.node[:, :3], axis=1) == np.sort(triangle)).all(axis=1)
        np.testing.assert_allclose(found.most_give[rows], room, rtol=1e-6)
    at_node = found.weight.max(axis=1) == 1.0
    for node, room in zip(found.node[at_node, 0], found.most_give[at_node], strict=True):
        assert room == pytest.approx(own[(organ.surface_triangles == node).any(axis=1)].min(), rel=1e-6)


def test_tool_that_is_not_engaged_has_no_entries():
    organ = ball(2)
    finder = make_finder(organ, Tool("left"), Tool("right"))
    pose = over(organ, (0.0, 0.0, 1.0), 0.0, 0.005)
    found = find(finder, organ, pose, pose, engaged=[0, 1])
    assert len(found.body) > 0
    assert np.all(found.body == 1)
    np.testing.assert_array_equal(found.engaged, [0, 1])


def test_same_poses_and_surface_give_the_same_set_whatever_was_found_before():
    organ = kidney()
    finder = make_finder(organ, Tool("left", radius=0.01))
    here, there = over(organ, (0.0, 0.1, 1.0), -0.004, 0.01), over(organ, (1.0, 0.1, 0.0), -0.004, 0.01)
    first = find(finder, organ, here)
    find(finder, organ, there)
    again = find(finder, organ, here)
    for name in ("body", "node", "weight", "normal"):
        np.testing.assert_array_equal(getattr(first, name), getattr(again, name))


def test_entries_beyond_the_capacity_are_dropped_farthest_first():
    organ = ball(4)  # 2562 nodes
    finder = make_finder(organ, Tool("left", radius=3.0 * RADIUS))
    pose = np.array([0.0, 0.0, 1.1 * RADIUS, *STILL])
    found = find(finder, organ, pose)
    assert len(found.body) == MAX_CONTACT_POINTS
    assert found.header.dropped >= organ.n_surface - MAX_CONTACT_POINTS
    check_entries(found, organ)
    distance = np.linalg.norm(organ.surface_positions - pose[:3], axis=1)
    kept = np.zeros(organ.n_surface, dtype=bool)
    kept[found.node[found.node[:, 0] == found.node[:, 1], 0]] = True
    assert distance[kept].max() <= distance[~kept].min() + 1e-12


def test_tool_is_inside_when_its_middle_is():
    organ = kidney()
    finder = make_finder(organ, Tool("left", radius=0.001), Tool("right", "capsule", radius=0.001, length=0.02))
    atom = organ.atom_positions[20]
    assert organ.atom_radius[20] > 0.012
    assert finder.is_inside(0, organ.rest_positions, np.array([*atom, *STILL]))
    # A capsule's middle lies half its length down the shaft.
    assert finder.is_inside(1, organ.rest_positions, np.array([*(atom + [0.0, 0.0, 0.01]), *STILL]))
    outside = over(organ, (0.0, 0.0, 1.0), 0.005)
    assert not finder.is_inside(0, organ.rest_positions, outside)
    assert not finder.is_inside(0, organ.rest_positions, np.array([5.0, 5.0, 5.0, *STILL]))


def between_nodes(organ, depth):
    """The pose of a capsule whose tip is `depth` m deep in the middle of a triangle; its shaft points outwards."""
    corners = organ.surface_positions[organ.surface_triangles[0]]
    way = np.cross(corners[2] - corners[0], corners[1] - corners[0])
    way /= np.linalg.norm(way)
    turn, _ = Rotation.align_vectors([way], [[0.0, 0.0, 1.0]])
    return np.concatenate([corners.mean(axis=0) + depth * way, turn.as_quat()])


def test_tool_whose_tip_alone_is_in_tissue_is_inside():
    organ = ball(2)
    finder = make_finder(organ, Tool("left", "capsule", radius=0.001, length=0.02))
    assert finder.is_inside(0, organ.rest_positions, between_nodes(organ, 0.0005))
    assert not finder.is_inside(0, organ.rest_positions, between_nodes(organ, -0.0005))


def test_tool_that_appears_with_its_tip_in_tissue_is_held_off_and_resisted_once_it_has_been_outside():
    """It was neither: it stood where it had appeared, and exerted no force wherever it went."""
    organ = ball(2)
    scene = Scene(organ, [Tool("left", "capsule", radius=0.001, length=0.02)])

    def go(depths):
        for depth in depths:
            pose = between_nodes(organ, depth)
            scene.move(0, pose[:3], pose[3:])
            scene.step()
        return scene.simulation.state.bodies[0], float(np.linalg.norm(scene.wrenches[0, :3]))

    status, force = go([0.003] * 20)
    assert status.held_off
    assert not status.engaged
    assert force == 0.0
    status, _ = go(np.linspace(0.003, -0.005, 50))
    assert status.engaged
    assert not status.held_off
    _, force = go(np.linspace(-0.005, 0.003, 200))
    assert force > 0.01, "N"


def test_tool_that_holds_a_node_counts_as_inside():
    organ = ball(2)
    finder = make_finder(organ, Tool("left", radius=0.005))
    assert finder.is_inside(0, organ.rest_positions, over(organ, (0.0, 0.0, 1.0), -0.001, 0.005))
    assert not finder.is_inside(0, organ.rest_positions, over(organ, (0.0, 0.0, 1.0), 0.001, 0.005))


# points under tips -----------------------------------------------------------------------------
def nearest_on_surface(organ, point):
    corners = organ.surface_positions[organ.surface_triangles]
    nearest = trimesh.triangles.closest_point(corners, np.repeat([point], len(corners), axis=0))
    distance = np.linalg.norm(nearest - point, axis=1)
    return nearest[distance.argmin()], distance.min()


@pytest.mark.parametrize("organ", [ball(1), kidney()], ids=["ball", "kidney"])
def test_point_under_a_tip_is_the_nearest_of_the_surface(organ):
    finder = make_finder(organ, Tool("left"))
    random = np.random.default_rng(0)
    for _ in range(60):
        triangle = organ.surface_triangles[random.integers(len(organ.surface_triangles))]
        tip = random.dirichlet([1, 1, 1]) @ organ.surface_positions[triangle] + random.normal(0.0, 0.002, 3)
        found = find(finder, organ, [*tip, *STILL], engaged=[0], pushing=[1])
        expected, distance = nearest_on_surface(organ, tip)
        assert found.tip_weight[0].sum() == pytest.approx(1.0)
        assert found.tip_weight[0].min() >= -1e-12
        point = found.tip_weight[0] @ organ.rest_positions[found.tip_node[0]]
        assert np.linalg.norm(point - tip) == pytest.approx(distance, abs=1e-9), expected


def test_tip_reaches_no_farther_than_it_should():
    organ = ball(2)
    finder = make_finder(organ, Tool("left"), Tool("right"))
    near, far = over(organ, (0.0, 0.0, 1.0), 0.99 * TIP_REACH), over(organ, (0.0, 0.0, 1.0), 1.01 * TIP_REACH)
    found = find(finder, organ, near, far, engaged=[0, 0], pushing=[1, 1])
    assert np.all(found.tip_node[0] >= 0)
    np.testing.assert_array_equal(found.tip_node[1], [-1, -1, -1, -1])
    np.testing.assert_array_equal(found.tip_weight[1], 0.0)
    silent = find(finder, organ, near, near, engaged=[0, 0], pushing=[0, 1])
    np.testing.assert_array_equal(silent.tip_node[0], [-1, -1, -1, -1])


# geometry --------------------------------------------------------------------------------------
@pytest.mark.parametrize("divisions", [0.2, 1.0, 1.5, 3.0, 7.7, 100.0])
def test_lattice_divides_a_triangle_evenly_without_its_corners(divisions):
    m = divisions_of(divisions)
    assert m == min(max(2, int(np.ceil(divisions))), 8)
    weights = edge_and_face_points(m)
    assert weights.shape == ((m + 1) * (m + 2) // 2 - 3, 3)
    np.testing.assert_allclose(weights.sum(axis=1), 1.0)
    assert weights.min() >= 0.0
    assert weights.max() < 1.0
    np.testing.assert_allclose(weights * m, np.round(weights * m), atol=1e-12)
    assert len(np.unique(np.round(weights, 9), axis=0)) == len(weights)


@pytest.mark.extended
def test_searches_keep_no_memory():
    """Of a tool near the surface, whose narrow phase is FCL's: python-fcl keeps 32 bytes of every object that goes."""
    organ = ball(2)
    finder = make_finder(organ, Tool("left", "sphere", RADIUS))
    pose = over(organ, (0.0, 0.0, 1.0), 0.0, RADIUS)

    def search(times):
        for _ in range(times):
            find(finder, organ, pose)
        return resident(os.getpid())[0]

    before = search(2_000)
    asked = finder.counters.narrow_phases
    assert search(30_000) - before < 0.4, "MB"
    assert finder.counters.narrow_phases == asked + 30_000


# how far a set reaches -------------------------------------------------------------------------
def test_a_set_has_every_point_that_a_tool_may_touch_within_its_reach():
    organ = kidney()
    finder = make_finder(organ, Tool("left", radius=0.005))
    pose = over(organ, (1.0, 0.3, 0.2), 0.002, 0.005)
    found = find(finder, organ, pose, margins=[0.004])
    assert found.reach[0] == pytest.approx(MARGIN + 0.004 - TISSUE_MOTION)
    assert found.n_points[0] == len(found.body) > 0
    np.testing.assert_array_equal(found.place[0], pose)
    distance = np.linalg.norm(organ.surface_positions - pose[:3], axis=1) - 0.005
    touched = set(np.flatnonzero(distance <= found.reach[0]).tolist())
    assert touched <= set(found.node[found.weight == 1.0].tolist())


def test_an_empty_set_reaches_as_far_as_the_boxes_are_apart():
    organ = ball(2)
    finder = make_finder(organ, Tool("left", radius=0.005))
    found = find(finder, organ, [1.0, 0.0, 0.0, *STILL])
    assert found.n_points[0] == 0
    apart = 1.0 - 0.005 - organ.surface_positions[:, 0].max()
    assert found.reach[0] == pytest.approx(apart - TISSUE_MOTION, abs=1e-9)


def test_what_has_slipped_inside_is_put_back_on_the_surface():
    organ = ball(2)
    finder = make_finder(organ, Tool("left", radius=0.005))
    top = np.array([0.0, 0.0, organ.surface_positions[:, 2].max()])
    inside = np.array([*(top - [0.0, 0.0, 0.008]), *STILL])
    found = find(finder, organ, inside)
    assert found.engaged[0] == Engaged.SLIPPED
    assert np.linalg.norm(found.place[0, :3]) > RADIUS + 0.005
    assert found.place[0, 2] > top[2]
    assert find(finder, organ, [*(top + [0.0, 0.0, 0.004]), *STILL]).engaged[0] == Engaged.YES


def test_margins_lead_to_where_tools_are_to_be_and_on():
    places, goals = np.array([[0.0, 0.0, 0.0, *STILL]] * 2), np.array([[0.004, 0.0, 0.0, *STILL]] * 2)
    last = goals - [0.001, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    np.testing.assert_allclose(reach_margins(places, goals, last, 2.0, np.array([0.0, 0.05])), 0.005)  # 4 + 2 - 1.5
    turned = goals.copy()
    turned[:, 3:] = 0.0, 0.0, np.sin(0.05), np.cos(0.05)
    alone, with_arm = reach_margins(goals, turned, turned, 0.0, np.array([0.0, 0.05]))
    assert alone == 0.0
    assert with_arm >= 0.05 * 2.0 * np.sin(0.05) - 0.0015, "a point on an arm of 50 mm, turned by 0.1"
