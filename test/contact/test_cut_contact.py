"""Tools and a cut organ: they touch lips and walls as these are now, and nothing where the cut is open."""

import numpy as np
import pytest

from helpers.pressing import lead, line
from helpers.slabs import INCISION, MIDDLE, SIZE, hold_open, opened, slab
from tissue_sim.contact.attachments import Attachment
from tissue_sim.contact.finder import ContactFinder, ContactQuery
from tissue_sim.contact.organ_contact_finder import OrganContactFinder
from tissue_sim.contact.scene import Scene
from tissue_sim.contact.tools import Tool, ToolSet
from tissue_sim.contact.touched_surface import TouchedSurface
from tissue_sim.contact.triangles import nearest_among
from tissue_sim.model.data.contact_set import POINT_NODES
from tissue_sim.organ.placement import placed
from tissue_sim.organ.winding import inside

BALL = Tool("left", radius=0.002)
TOP = SIZE[2]


def pushes(scene):
    """Force on the tissue at each contact point, (c, 3) N, and on every node, (n, 3) N, in the last substep."""
    state, shapes = scene.simulation.state, scene.tools.shapes
    contacts, points = state.contacts, int(state.contacts.header.points)
    assert (shapes.kind == 0).all(), "balls only"
    place = np.einsum("kc,kcx->kx", contacts.weight[:points], state.position[contacts.node[:points]])
    normal = place - state.body_pose[contacts.body[:points], :3]
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)
    pressed, held = state.contact_pressed[0, :points], state.contact_held[0, :points]
    push = (pressed[:, None] * normal + held) * int(state.status.substeps) / scene.simulation.settings.tick_time
    nodes = np.zeros_like(state.position)
    np.add.at(nodes, contacts.node[:points], contacts.weight[:points, :, None] * push[:, None, :])
    return push, nodes


def sides(scene):
    """Nodes whose copies are on the left and on the right of the incision."""
    x = scene.simulation.model.rest[:, 0]
    cut = scene.simulation.cut_organ
    n = cut.uncut.n_nodes
    left = x < MIDDLE
    # A virtual node belongs to the side that it does not lie on.
    left[n:] = ~left[n:]
    return left, ~left


def test_a_ball_passes_the_former_skin_and_touches_the_walls():
    tool = Tool("left", radius=0.004)
    scene = opened([tool])
    way = line([MIDDLE, 0.015, TOP + 0.006], [MIDDLE, 0.015, TOP - 0.005], 80)
    assert np.abs(lead(scene, 0, way, 20)).max() == 0.0
    assert scene.simulation.state.body_pose[0, 2] == pytest.approx(TOP - 0.005, abs=1e-6)
    assert scene.simulation.state.bodies[0].engaged
    # The skin between the lips stops it.
    whole = Scene(slab(), [tool])
    hold_open(whole, 0.006)
    assert lead(whole, 0, way, 20)[-1, 2] > 0.05
    # Deeper, both walls and the floor resist, each lip on its side.
    force = lead(scene, 0, line(way[-1], [MIDDLE, 0.015, 0.010], 300), 100)[-1]
    assert force[2] > 0.1
    _, nodes = pushes(scene)
    left, right = sides(scene)
    assert nodes[left, 0].sum() < -0.02
    assert nodes[right, 0].sum() > 0.02


def test_forces_on_the_tissue_are_minus_the_wrench():
    """On walls, where points lie between the nodes of a cell, and with friction."""
    scene = opened([BALL])
    scene.simulation.settings.force_clamp = 100.0
    lead(scene, 0, line([MIDDLE, 0.015, TOP + 0.004], [MIDDLE + 0.001, 0.016, 0.008], 300), 100)
    push, nodes = pushes(scene)
    force = scene.wrenches[0, :3]
    assert np.linalg.norm(force) > 0.02
    np.testing.assert_allclose(push.sum(axis=0), -force, atol=0.02 * np.linalg.norm(force))  # of the last substep
    np.testing.assert_allclose(nodes.sum(axis=0), push.sum(axis=0), rtol=1e-9, atol=1e-12)
    contacts = scene.simulation.state.contacts
    points = int(contacts.header.points)
    assert (contacts.weight[:points, 3] != 0.0).any(), "no point between four nodes"
    np.testing.assert_allclose(contacts.weight[:points].sum(axis=1), 1.0, rtol=1e-12)
    assert contacts.weight[:points].min() >= 0.0


def test_a_lip_resists_less_than_the_tissue_did_before_the_cut():
    def force(scene):
        at = [MIDDLE + 0.004, 0.015, TOP]
        return lead(scene, 0, line([*at[:2], TOP + 0.007], [*at[:2], TOP + 0.002], 60), 300)[-1, 2]

    tool = Tool("left", radius=0.005)
    before = force(Scene(slab(), [tool]))
    scene = Scene(slab(), [tool])
    scene.cut(0, *INCISION)
    after = force(scene)
    assert 0.3 * before < after < 0.97 * before


@pytest.mark.parametrize("radius", [0.0015, 0.003, pytest.param(0.006, marks=pytest.mark.extended)])
@pytest.mark.parametrize("way", [0.0, 0.006], ids=["closed", "open"])
def test_wherever_a_hand_presses_it_feels_the_tissue(radius, way):
    """Along the normal at many places of lips, rims and walls that a ball can reach; and nothing before it touches."""
    scene = opened([Tool("left", radius=radius)], way)
    touched = scene.finder.surface
    start = scene.simulation.positions.copy()
    points = touched.at(start).copy()
    corners = points[touched.triangles]
    centre = corners.mean(axis=1)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    near = np.abs(centre[:, 0] - MIDDLE) < 0.012
    near &= (centre[:, 1] > 0.004) & (centre[:, 1] < 0.026) & (centre[:, 2] > 0.012)
    chosen = np.flatnonzero(near)
    state, tried = scene.simulation.state.words.copy(), 0
    for triangle in np.random.default_rng(0).permutation(chosen):
        place, out = centre[triangle], normal[triangle]
        apart = place + (radius + 0.0005) * out
        if inside(apart[None], points, touched.triangles)[0] or clearance(points, touched.triangles, apart) < radius:
            continue  # the opening is too narrow
        tried += 1
        if tried > 15:
            break
        scene.simulation.state.words[:] = state
        assert np.abs(lead(scene, 0, [apart], 5)).max() < 1e-12, place
        force = lead(scene, 0, line(apart, place + (radius - 0.0015) * out, 25), 25)[-1]
        assert force @ out > 0.001, place
        assert scene.simulation.state.count.faults == 0
    assert tried > 10


def clearance(points, triangles, place):
    """Distance of a place from a surface, m."""
    return nearest_among(points[triangles], place[None])[2][0]


def test_a_tool_in_the_open_cut_is_outside_and_one_in_a_lip_inside():
    scene = opened([BALL])
    position = scene.simulation.positions
    finder = scene.finder
    for x, z, within in ((MIDDLE, TOP - 0.004, False), (MIDDLE - 0.012, TOP - 0.01, True), (MIDDLE, 0.004, True)):
        pose = np.array([x, 0.015, z, 0.0, 0.0, 0.0, 1.0])
        assert finder.is_inside(0, position, pose) == within, (x, z)


def test_the_way_out_of_a_closed_lip_is_not_the_other_lip():
    scene = Scene(slab(), [BALL])
    scene.cut(0, *INCISION)
    position, finder = scene.simulation.positions, scene.finder
    for x in (MIDDLE - 0.001, MIDDLE + 0.001):
        at = np.array([x, 0.015, TOP - 0.008])
        way = finder._way_out(0, finder.surface.at(position), np.array([*at, 0.0, 0.0, 0.0, 1.0]))
        assert not inside((at + way)[None], finder.surface.at(position), finder.triangles)[0]
        assert (at + way)[2] > TOP


def test_places_between_nodes_are_those_of_the_surface():
    """Of any place in any triangle, in any shape of the organ; weights are barycentric."""
    scene = Scene(slab(), [BALL])
    scene.cut(0, *INCISION)
    surface, cut = scene.finder.surface, scene.simulation.cut_organ
    random = np.random.default_rng(0)
    position = scene.simulation.positions + 0.001 * random.normal(size=scene.simulation.positions.shape)
    points = surface.at(position)
    np.testing.assert_allclose(points, cut.surface.at(position), atol=1e-15)
    triangle = np.arange(len(surface.triangles))
    weight = random.dirichlet([1.0, 1.0, 1.0], len(triangle))
    corners = surface.triangles.astype(np.int64)
    nodes, weights = surface.between(triangle, corners, weight)
    assert nodes.shape == weights.shape == (len(triangle), POINT_NODES)
    np.testing.assert_allclose(
        np.einsum("kc,kcx->kx", weights, position[nodes]), np.einsum("kc,kcx->kx", weight, points[corners]), atol=1e-15
    )
    assert weights.min() >= 0.0


def test_an_uncut_organ_has_its_nodes_as_points():
    surface = TouchedSurface.of(slab())
    position = slab().rest_positions
    assert surface.at(position) is position
    corners = slab().surface_triangles[:5].astype(np.int64)
    weight = np.full((5, 3), 1.0 / 3.0)
    nodes, weights = surface.between(np.arange(5), corners, weight)
    np.testing.assert_array_equal(nodes, np.column_stack([corners, corners[:, 0]]))
    np.testing.assert_array_equal(weights, np.column_stack([weight, np.zeros(5)]))


def test_far_from_the_cut_points_and_compliance_are_those_of_the_uncut_organ():
    tools = ToolSet([BALL, Tool("right", "capsule", radius=0.003, length=0.03)])
    scene = Scene(slab(), [BALL])
    scene.cut(0, *INCISION)
    before, after = ContactFinder(slab(), tools), ContactFinder.of(scene.simulation, tools)
    pose = np.array([[0.003, 0.015, TOP + 0.001, 0.0, 0.0, 0.0, 1.0], [0.003, 0.02, TOP, 0.0, 0.0, 0.0, 1.0]])
    query = ContactQuery(
        pose, np.zeros(2), np.ones(2, dtype=np.int64), np.ones(2, dtype=np.int64), np.zeros(2, np.int64)
    )
    wanted, found = before.find(slab().rest_positions, query), after.find(scene.simulation.positions, query)
    assert len(wanted.body) > 10
    for name in ("body", "node", "weight", "normal", "most_give", "tip_node", "tip_weight"):
        np.testing.assert_array_equal(getattr(found, name), getattr(wanted, name), err_msg=name)
    np.testing.assert_allclose(found.compliance, wanted.compliance, rtol=1e-12)


def test_tissue_between_contact_points_yields_as_much_on_an_area_as_without_the_cut():
    """The stiffness of all points under a ball together: at the cut there are more, each of a smaller area."""
    tools = ToolSet([Tool("left", radius=0.008)])
    scene = Scene(slab(), [BALL])
    scene.cut(0, *INCISION)
    pose = np.array([[MIDDLE, 0.015, TOP + 0.0075, 0.0, 0.0, 0.0, 1.0]])
    one, none = np.ones(1, dtype=np.int64), np.zeros(1, dtype=np.int64)

    def stiffness(finder, position):
        found = finder.find(position, ContactQuery(pose, np.array([0.003]), one, none, none))
        places = np.einsum("kc,kcx->kx", found.weight, position[found.node])
        above = (places[:, 2] > TOP - 1e-9) & (np.abs(places[:, 0] - MIDDLE) < 0.006)
        return above.sum(), (1.0 / found.compliance[above, 0]).sum()

    points, wanted = stiffness(ContactFinder(slab(), tools), slab().rest_positions)
    more, found = stiffness(ContactFinder.of(scene.simulation, tools), scene.simulation.positions)
    assert more > 1.3 * points
    assert found == pytest.approx(wanted, rel=0.25)


def test_a_force_at_a_tip_in_the_cut_acts_on_the_wall_beside_it():
    scene = opened([BALL])
    at = [MIDDLE - 0.003, 0.015, TOP - 0.007]
    for _ in range(30):
        scene.move(0, at)
        scene.push(0, [-0.05, 0.0, 0.0])
        scene.step()
    left, _ = sides(scene)
    contacts = scene.simulation.state.contacts
    used = contacts.tip_node[0][contacts.tip_weight[0] > 0.0]
    assert contacts.tip_weight[0].sum() == pytest.approx(1.0)
    assert left[used].all()


def test_reset_heals_a_scene_with_its_settings():
    scene = Scene(slab(), [BALL])
    scene.simulation.settings.stiffness_scale = 2.0
    scene.set_substeps()
    before = scene.finder
    report = scene.cut(0, *INCISION)
    assert report.new_nodes > 0
    assert scene.finder is not before
    scene.simulation.settings.friction = 0.1
    scene.step(5)
    scene.reset()
    assert scene.simulation.cuts == ()
    assert scene.finder is before
    settings = scene.simulation.settings
    assert (settings.stiffness_scale, settings.friction) == (2.0, 0.1)
    way = line([MIDDLE, 0.015, TOP + 0.003], [MIDDLE, 0.015, TOP], 30)
    assert lead(scene, 0, way, 30)[-1, 2] > 0.01


def test_an_organ_of_a_scene_is_cut_while_it_touches_and_hangs_on_others():
    """The other one, links and contact go on; momentum of what is held by nothing is that of the tool's force."""
    other = placed(slab(), [0.0405, 0.0, 0.0])
    links = [Attachment((0, 1), stiffness=50.0, damping=0.1, within=0.0006)]
    scene = Scene([slab(), other], [BALL], attachments=links, gravity=[0.0, 0.0, 0.0])
    lead(scene, 0, line([0.03, 0.015, TOP + 0.004], [0.03, 0.015, TOP], 20))
    before = scene.wrench(0)[2]
    assert before > 0.01
    report = scene.cut(0, *INCISION)
    assert report.cells_cut > 0
    assert scene.joined.simulations[0] is scene.simulation
    forces = lead(scene, 0, [[0.03, 0.015, TOP]], 30)
    # Not from nothing: points that are still there go on with their forces.
    assert forces[0, 2] > 0.6 * before
    assert forces[:, 2].min() > 0.5 * before
    assert scene.simulation.state.count.faults == 0


def test_other_organs_touch_no_skin_over_the_opening():
    scene = opened([BALL])
    lying = slab().surface_positions * [0.05, 0.3, 0.1] + [MIDDLE - 0.001, 0.01, TOP - 0.001]
    finder = OrganContactFinder([slab(), slab()])
    # A small piece, between the lips where the skin was.
    there = np.concatenate([lying, np.zeros((slab().n_nodes - slab().n_surface, 3))])
    whole = finder.find([scene.simulation.positions, there])
    old = {tuple(row) for row in scene.finder.surface.old_triangles.tolist()}

    def on_skin(found):
        own = np.flatnonzero(found.organ[: int(found.found[0]), 1] == 0)
        return [row for row in found.node[own, 1:].tolist() if min(row) >= 0 and tuple(row) not in old]

    assert on_skin(whole)
    finder.exchange(0, scene.finder.surface, 1)
    assert not on_skin(finder.find([scene.simulation.positions, there]))


def test_a_reset_after_a_cut_leaves_time_and_counters_as_they_are():
    scene = Scene(slab(), [], ticks_a_set=4)
    scene.step(5)
    scene.cut(0, *INCISION)
    scene.simulation.apply_force([0], [[0.0, 0.0, 0.1]])
    scene.step(20)
    before, slept = scene.simulation.time, int(scene.simulation.state.count.asleep_ticks)
    scene.reset()
    assert not scene.simulation.cuts
    assert scene.simulation.time == before == 0.025
    assert scene.simulation.state.count.asleep_ticks == slept == 5
    np.testing.assert_array_equal(scene.simulation.positions, slab().rest_positions)
    scene.step(3)
    assert scene.simulation.time == pytest.approx(0.028)
