"""Tools on tissue, whole ticks: balance of forces, depth, friction, clamp, staleness, release."""

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from helpers.kernels import by_reference
from helpers.pressing import PROBE, deepest, is_sound, lead, line, press, top_of
from helpers.scenes import RADIUS, ball, free_ball, kidney
from helpers.states import is_finite
from helpers.turns import random_turns
from tissue_sim.contact.attachments import Breathing
from tissue_sim.contact.scene import Scene
from tissue_sim.contact.tools import Tool
from tissue_sim.model.contact.active_contact import RECOVERY_SPEED, place_tool, take_nodes
from tissue_sim.model.contact.constraint import apply_impulse, count_impulse
from tissue_sim.model.elasticity.forces import elastic_forces
from tissue_sim.organ.placement import placed
from tissue_sim.organ.winding import inside


def test_gravity_is_that_of_all_organs_and_stays_beside_a_breath():
    scene = Scene([ball(1), placed(ball(1), [0.1, 0.0, 0.0])], [], breathing=Breathing(0.0, [0.0, 0.0, 0.01]))
    scene.set_gravity([0.0, 0.0, -9.81])
    for _ in range(3):
        scene.step()
    assert [one.settings.gravity_z for one in scene.simulations] == [-9.81, -9.81]


# poses that come late ---------------------------------------------------------------------------
def poke(gap, period):
    """Forces, (ticks,) N, of a tool that goes 6 mm into the kidney and out; in each 100 ms no pose comes for a gap."""
    scene = Scene(kidney(), [Tool("left", "sphere", radius=0.005)], ticks_a_set=4)
    outermost = kidney().surface_positions[np.argmax(kidney().surface_positions[:, 0])]
    forces = []
    for tick in range(round(1.2 * period)):
        if tick % 100 >= gap:
            depth = -0.004 + 0.005 * (1.0 - np.cos(2.0 * np.pi * tick / period))
            scene.move(0, outermost + [0.005 - depth, 0.0, 0.0], stamp=1_000_000 * (1000 + tick))
        scene.step()
        forces.append(scene.wrenches[0, :3].copy())
    return np.linalg.norm(forces, axis=1)


@pytest.mark.parametrize("period", [pytest.param(400, marks=pytest.mark.extended), 1000])
def test_poses_that_come_late_change_the_highest_force_by_a_tenth_at_most(period):
    undisturbed = poke(0, period).max()
    for gap in (10, 30, 45):
        assert poke(gap, period).max() == pytest.approx(undisturbed, rel=0.1), gap


def test_a_tool_that_comes_back_elsewhere_feels_nothing_of_before():
    """However slowly a force may change: it was released meanwhile."""
    scene = Scene(ball(2), [Tool("left", "sphere", radius=0.005)])
    scene.simulation.settings.force_slew = 1.0
    top = scene.simulation.organ.surface_positions[:, 2].max()
    for tick in range(400):
        scene.move(0, [0.0, 0.0, top + 0.006 - 0.005 * min(1.0, tick / 100.0)])
        scene.step()
    assert np.linalg.norm(scene.wrenches[0]) > 0.05
    for _ in range(75):  # stale after 50, released after 70
        scene.step()
    assert not scene.wrenches.any()
    scene.move(0, [0.0, 0.0, 1.0])
    scene.step()
    assert not scene.wrenches.any()


# equal and opposite ----------------------------------------------------------------------------
@pytest.mark.parametrize("friction", [0.0, 0.6])
@pytest.mark.parametrize("subdivisions", [1, 2])
def test_momentum_of_a_free_organ_changes_by_minus_the_wrench(friction, subdivisions):
    organ = free_ball(subdivisions)
    scene = Scene(organ, [PROBE, Tool("right", "capsule", radius=0.004, length=0.05)])
    scene.simulation.settings.friction = friction
    scene.simulation.settings.force_clamp = 100.0
    above = top_of(organ) + [0.0, 0.0, 0.008]
    side = np.array([RADIUS + 0.004, 0.0, 0.025])
    momentum, forces, most = [np.zeros(3)], [], np.zeros(2)
    for tick in range(150):
        scene.move(0, above + [2e-5 * tick, 1e-5 * tick, 0.001 - 4e-5 * tick])
        scene.move(1, side - [3e-5 * tick, 2e-5 * tick, 0.0])
        scene.step()
        momentum.append(organ.mass @ scene.simulation.velocities)
        forces.append(scene.wrenches[:, :3].sum(axis=0))
        most = np.maximum(most, np.linalg.norm(scene.wrenches[:, :3], axis=1))
    change = np.diff(momentum, axis=0) / 1e-3
    assert most.min() > 0.05, "a tool did not touch"
    assert np.abs(change + forces).max() < 1e-9
    assert is_sound(scene)


def test_angular_momentum_of_a_free_organ_changes_by_minus_the_moment():
    """About the tool's origin, which stands still once the tool does; to the first order in the substep."""
    organ = free_ball(2)
    scene = Scene(organ, [PROBE])
    origin = top_of(organ) + [0.004, 0.003, 0.007]
    spin = []
    lead(scene, 0, line(origin + [0.0, 0.0, 0.003], origin, 30))
    moments = []
    for _ in range(40):
        arm = scene.simulation.positions - origin
        spin.append(np.cross(arm, organ.mass[:, None] * scene.simulation.velocities).sum(axis=0))
        lead(scene, 0, origin)
        moments.append(scene.wrenches[0, 3:].copy())
    change = np.diff(spin, axis=0) / 1e-3
    largest = np.abs(moments).max()
    assert largest > 1e-5
    assert np.abs(change + moments[:-1]).max() < 0.02 * largest


@pytest.mark.parametrize("tool", [0, 1])
def test_every_push_on_the_tissue_is_counted_with_its_moment_about_the_bodys_origin(tool):
    """The wrench is minus the sum of these pushes: the momentum that they give, and their moments, to 1e-9 of them."""
    organ = free_ball(2)
    scene = Scene(organ, [PROBE, Tool("right", "capsule", radius=0.004, length=0.05)])
    scene.move(0, top_of(organ) + [0.0, 0.0, 0.005])
    scene.move(1, [RADIUS + 0.005, 0.0, 0.025])
    scene.step()
    simulation = scene.simulation
    state, scratch, world = simulation.state, simulation.scratch, by_reference(simulation)
    own = np.flatnonzero(state.contacts.body[: state.contacts.header.points] == tool)
    assert len(own) > 5
    random = np.random.default_rng(tool)
    mobility = 1.0 / organ.mass
    scratch.impulse[:] = 0.0
    expected, before = np.zeros(6), organ.mass @ simulation.velocities
    for entry in own:
        impulse = random.normal(0.0, 1.0, 3)
        arm = state.contacts.weight[entry] @ state.position[state.contacts.node[entry]] - scratch.origin[tool]
        expected += np.concatenate([impulse, np.cross(arm, impulse)])
        contact = scratch.active[0]
        contact.entry, contact.body, contact.pressed, contact.held = entry, tool, 0.0, impulse
        place_tool(world.state, world.shapes, world.scratch, contact)
        take_nodes(world.state, mobility, contact)
        count_impulse(world.state, world.scratch, contact)
        apply_impulse(world, contact, tuple(impulse), 1e-3)
    np.testing.assert_allclose(scratch.impulse[tool], expected, atol=1e-9 * len(own))
    np.testing.assert_allclose(organ.mass @ simulation.velocities - before, expected[:3], atol=1e-9 * len(own))
    np.testing.assert_array_equal(scratch.origin[tool], state.body_pose[tool, :3])
    assert not scratch.impulse[1 - tool].any()


def test_wrench_balances_the_elastic_forces_when_all_is_still():
    scene = Scene(ball(2), [PROBE])
    press(scene, 0.004, hold=600)
    simulation = scene.simulation
    still = scene.wrenches[0, :3]
    assert still[2] > 0.1
    force = np.zeros_like(simulation.positions)
    elastic_forces(simulation.model, simulation.positions, 1.0, force)
    assert np.abs(force[simulation.model.moving].sum(axis=0) - still).max() < 1e-3 * still[2]


# depth -----------------------------------------------------------------------------------------
@pytest.mark.parametrize("organ", [ball(2), kidney()], ids=["ball", "kidney"])
@pytest.mark.parametrize("depth", [0.003, 0.008])
def test_no_node_is_deep_inside_the_tool_at_rest_after_a_poke(organ, depth):
    scene = Scene(organ, [PROBE])
    forces = press(scene, depth, hold=300)
    assert scene.simulation.state.status.touching > 0
    assert deepest(scene) < 2e-4
    assert forces[-1, 2] > 0.05
    # It holds still: no chatter between contact points.
    assert np.ptp(forces[-50:], axis=0).max() < 1e-3
    assert is_sound(scene)


def test_force_grows_with_depth():
    reached = []
    for depth in (0.001, 0.003, 0.005, 0.007):
        scene = Scene(kidney(), [PROBE])
        reached.append(press(scene, depth, hold=200)[-1, 2])
    assert np.all(np.diff(reached) > 0.0)
    assert reached[0] > 0.0


def test_instrument_shaft_laid_along_the_organ_sinks_in_nowhere():
    organ = kidney()
    scene = Scene(organ, [Tool("left", "capsule", radius=0.0025, length=0.08)])
    # The capsule's axis, its own z, turned along the kidney's length.
    middle = organ.surface_positions.mean(axis=0)
    side = organ.surface_positions[:, 0].max() + 0.0025
    forces = []
    for x in [*np.linspace(side + 0.002, side - 0.006, 100), *[side - 0.006] * 200]:
        scene.move(0, [x, middle[1], middle[2] + 0.04])
        scene.step()
        forces.append(scene.wrenches[0, 0])
    assert deepest(scene) < 3e-4
    assert forces[-1] > 0.1
    assert is_sound(scene)


def test_instrument_tip_pressed_by_a_mesh_tool_is_held(tmp_path):
    blade = trimesh.creation.box((0.006, 0.006, 0.03))
    blade.apply_translation([0.0, 0.0, 0.015])
    blade.export(tmp_path / "blade.stl")
    scene = Scene(kidney(), [Tool("left", "mesh", mesh=str(tmp_path / "blade.stl"))])
    forces = press(scene, 0.004, radius=0.0)
    assert forces[-1, 2] > 0.05
    assert deepest(scene) < 2e-4
    assert is_sound(scene)


# small tools -----------------------------------------------------------------------------------
def push_through_the_middle(organ, radius, number, travel=0.004):
    """Lead a small ball along a triangle's normal through its middle; the largest force and the gap at the end."""
    triangle = organ.surface_triangles[number]
    a, b, c = organ.surface_positions[triangle]
    normal = np.cross(b - a, c - a) / np.linalg.norm(np.cross(b - a, c - a))
    middle = (a + b + c) / 3.0
    scene = Scene(organ, [Tool("needle", radius=radius)])
    start = middle + (radius + 0.001) * normal
    lead(scene, 0, line(start, start - (travel + 0.001) * normal, 100), hold=50)
    x = scene.simulation.positions[triangle]
    facing = np.cross(x[1] - x[0], x[2] - x[0])
    facing /= np.linalg.norm(facing)
    above = (scene.simulation.state.body_pose[0, :3] - x[0]) @ facing
    assert is_sound(scene)
    return float(np.linalg.norm(scene.wrenches[0, :3])), above


@pytest.mark.parametrize("radius", [0.003, 0.0015])
@pytest.mark.parametrize("number", [20, *(pytest.param(number, marks=pytest.mark.extended) for number in (3, 45))])
def test_tool_much_smaller_than_a_triangle_is_held_by_its_middle(radius, number):
    """Edges of 17 mm, a ball of 3 to 6 mm across."""
    force, above = push_through_the_middle(ball(1), radius, number)
    assert force > 0.02
    assert above > 0.0


@pytest.mark.parametrize("radius", [0.0005, pytest.param(0.001, marks=pytest.mark.extended)])
def test_needle_finer_than_the_contact_points_is_held_too(radius):
    """The finest tool that is allowed does not slip between two contact points."""
    force, above = push_through_the_middle(ball(2), radius, 40, travel=0.002)
    assert force > 0.005
    assert above > 0.0


# speed -----------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    "tool",
    [
        Tool("left", radius=0.005),
        Tool("left", radius=0.002),
        Tool("left", "capsule", radius=0.002, length=0.04),
    ],
    ids=lambda tool: f"{tool.shape} {tool.radius:g}",
)
@pytest.mark.parametrize(
    "direction",
    [(1.0, 0.0, 0.0), *(pytest.param(way, marks=pytest.mark.extended) for way in ((0.0, -1.0, 0.2), (0.0, 0.1, 1.0)))],
)
def test_tool_at_one_metre_a_second_does_not_pass_through(tool, direction):
    """A pose a millisecond, a contact set every fourth, 8 mm into the kidney: it stays outside of the surface."""
    organ = kidney()
    scene = Scene(organ, [tool], ticks_a_set=4)
    way = np.array(direction) / np.linalg.norm(direction)
    start = organ.surface_positions[np.argmax(organ.surface_positions @ way)] + (tool.radius + 0.006) * way
    turn = Rotation.align_vectors([-way], [[0.0, 0.0, 1.0]])[0].as_quat()
    for tick in range(400):
        scene.move(0, start - min(1e-3 * tick, 0.014) * way, turn)
        scene.step()
    simulation = scene.simulation
    assert scene.wrenches[0, :3] @ way > 0.02
    assert deepest(scene) < 2e-4
    middle = simulation.state.body_pose[0, :3]
    assert not inside(middle[None], simulation.positions[: organ.n_surface], organ.surface_triangles)[0]
    assert is_sound(scene)


# release ---------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    "region", ["auto", *(pytest.param(region, marks=pytest.mark.extended) for region in ("off", "frozen"))]
)
def test_force_is_exactly_nothing_after_the_tool_has_left(region):
    organ = kidney()
    scene = Scene(organ, [PROBE], local_region=region)
    forces = press(scene, 0.002, hold=50)
    reach = np.abs(scene.simulation.positions - organ.rest_positions).max()
    assert np.linalg.norm(forces[-1]) > 0.01
    up = top_of(organ) + [0.0, 0.0, 0.008]
    lead(scene, 0, line(up - [0.0, 0.0, 0.002], up + [0.0, 0.0, 0.02], 50))
    after = lead(scene, 0, up + [0.0, 0.0, 0.02], hold=1200)
    np.testing.assert_array_equal(after, 0.0)
    np.testing.assert_array_equal(scene.wrenches, 0.0)
    assert scene.simulation.asleep
    assert np.abs(scene.simulation.positions - organ.rest_positions).max() < 0.01 * reach


def test_hovering_tool_feels_nothing_and_lets_the_organ_sleep():
    organ = kidney()
    scene = Scene(organ, [PROBE])
    forces = lead(scene, 0, top_of(organ) + [0.0, 0.0, 0.0085], hold=100)
    assert scene.contacts.header.points > 0
    np.testing.assert_array_equal(forces, 0.0)
    assert scene.simulation.asleep
    np.testing.assert_array_equal(scene.simulation.positions, organ.rest_positions)


# friction --------------------------------------------------------------------------------------
def plate(folder):
    """A flat plate of 80 x 80 x 20 mm, its underside at the origin, facing -z."""
    mesh = trimesh.creation.box((0.08, 0.08, 0.02))
    mesh.apply_translation([0.0, 0.0, 0.01])
    mesh.export(folder / "plate.stl")
    return Tool("left", "mesh", mesh=str(folder / "plate.stl"))


def pressed_and_dragged(scene, speed, ticks=120):
    """Forces while a plate is pressed 3 mm down on the top and then dragged along x at `speed` m/s."""
    press(scene, 0.003, hold=150, radius=0.0)
    at = scene.simulation.state.body_pose[0, :3].copy()
    return lead(scene, 0, line(at, at + [speed * ticks * 1e-3, 0.0, 0.0], ticks))


@pytest.mark.parametrize("friction", [0.0, pytest.param(0.2, marks=pytest.mark.extended), 0.6])
def test_tangential_force_stays_in_the_friction_cone(tmp_path, friction):
    scene = Scene(ball(2), [plate(tmp_path)])
    scene.simulation.settings.friction = friction
    forces = pressed_and_dragged(scene, 0.15)
    normal, tangential = forces[:, 2], np.linalg.norm(forces[:, :2], axis=1)
    assert normal.min() > 0.1
    assert np.all(tangential <= friction * normal + 1e-9)
    if friction == 0.0:
        assert tangential.max() < 1e-9
    else:
        # It drags: pulled back against the motion, and at the cone's edge once it slides.
        assert forces[20:, 0].max() < 0.0
        assert tangential[-1] > 0.9 * friction * normal[-1]
    assert is_sound(scene)


def test_smooth_ball_feels_no_moment_about_its_middle():
    """Without friction every contact force passes through the middle of a spherical tool."""
    moments = {}
    for friction in (0.0, 0.6):
        scene = Scene(kidney(), [PROBE])
        scene.simulation.settings.friction = friction
        press(scene, 0.003, hold=20)
        at = scene.simulation.state.body_pose[0, :3].copy()
        lead(scene, 0, line(at, at + [0.004, 0.002, 0.0], 40))
        moments[friction] = np.linalg.norm(scene.wrenches[0, 3:])
        assert np.linalg.norm(scene.wrenches[0, :3]) > 0.05
    assert moments[0.0] < 1e-12
    assert moments[0.6] > 1e-5


def shear(scene, node):
    """What the tissue between nodes gives way by along x under a plate at a node, m."""
    state = scene.simulation.state
    (at,) = np.flatnonzero((state.contacts.node[:, 0] == node) & (state.contacts.weight[:, 0] == 1.0))
    step = scene.simulation.settings.tick_time / state.status.substeps
    return float(state.contacts.compliance[at, 1] * state.contact_held[0, at, 0] / step)


def test_stuck_tissue_follows_the_tool(tmp_path):
    """Dragged slowly by less than the cone allows, the touched nodes move along; without friction they stay."""
    moved, sheared = {}, {}
    for friction in (0.0, 5.0):
        scene = Scene(ball(2), [plate(tmp_path)])
        scene.simulation.settings.friction = friction
        press(scene, 0.003, hold=150, radius=0.0)
        node = int(np.argmax(scene.simulation.positions[:162, 2]))
        before, start = scene.simulation.positions[node].copy(), shear(scene, node)
        at = scene.simulation.state.body_pose[0, :3].copy()
        lead(scene, 0, line(at, at + [0.001, 0.0, 0.0], 100))
        moved[friction] = scene.simulation.positions[node, 0] - before[0]
        sheared[friction] = shear(scene, node) - start
    assert sheared[0.0] == 0.0
    assert 1e-5 < sheared[5.0] < 1e-4, "what is between nodes gives way, too"
    assert moved[5.0] + sheared[5.0] == pytest.approx(0.001, rel=0.01)
    assert abs(moved[0.0]) < 1e-4


# clamp -----------------------------------------------------------------------------------------
def test_force_is_cut_to_the_clamp_in_its_direction():
    free, cut = Scene(kidney(), [PROBE]), Scene(kidney(), [PROBE])
    cut.simulation.settings.force_clamp = 0.1
    whole, clamped = press(free, 0.006, hold=0), press(cut, 0.006, hold=0)
    size, limited = np.linalg.norm(whole, axis=1), np.linalg.norm(clamped, axis=1)
    assert size.max() > 0.3
    np.testing.assert_allclose(limited, np.minimum(size, 0.1), rtol=1e-12)
    np.testing.assert_allclose(clamped * size[:, None], whole * limited[:, None], atol=1e-12)
    assert cut.simulation.state.count.clamped_ticks == np.count_nonzero(size > 0.1)
    assert free.simulation.state.count.clamped_ticks == 0
    # What the tissue feels is not cut.
    np.testing.assert_array_equal(cut.simulation.positions, free.simulation.positions)


# staleness -------------------------------------------------------------------------------------
def test_stale_pose_ramps_the_wrench_to_nothing_and_never_up():
    scene = Scene(kidney(), [PROBE])
    press(scene, 0.004, hold=400)
    scene.simulation.settings.stale_time, scene.simulation.settings.ramp_time = 0.05, 0.02
    held = np.linalg.norm(scene.wrenches[0, :3])
    sizes = []
    for _ in range(75):
        scene.step()
        sizes.append(np.linalg.norm(scene.wrenches[0, :3]))
    sizes = np.array(sizes)
    assert held > 0.1
    # The hold ended with a tick of its own: 49 more are fresh.
    np.testing.assert_allclose(sizes[:49], held, rtol=0.01)
    assert np.diff(sizes).max() < 1e-5 * held
    np.testing.assert_allclose(sizes[49:69], held * (1.0 - np.arange(1, 21) / 20.0), atol=0.02 * held)
    np.testing.assert_array_equal(sizes[69:], 0.0)
    np.testing.assert_array_equal(scene.wrenches[0], 0.0)


def test_stale_tool_lets_the_organ_go_and_goes_on_from_where_a_new_pose_is():
    scene = Scene(ball(2), [PROBE])
    press(scene, 0.002, hold=20)
    for _ in range(1200):
        scene.step()
        if scene.simulation.asleep:
            break
    assert scene.simulation.asleep
    assert np.abs(scene.simulation.positions - scene.simulation.model.rest).max() < 1e-5
    pose = top_of(ball(2)) + [0.01, 0.0, 0.02]
    lead(scene, 0, pose, hold=30)
    np.testing.assert_array_equal(scene.simulation.state.body_pose[0, :3], pose)
    assert scene.simulation.state.bodies[0].engaged
    assert scene.simulation.state.count.faults == 0


@pytest.mark.extended
def test_tissue_that_closed_around_a_tool_comes_off_it_evenly():
    """As deep as a jaw that was released and is taken up again, without the node's check whether it is outside."""
    organ = kidney()
    scene = Scene(organ, [PROBE])
    place = top_of(organ) + [0.0, 0.0, 0.004]
    fastest, deep = 0.0, []
    for _ in range(300):
        scene.move(0, place)
        scene.step()
        fastest = max(fastest, float(np.abs(scene.simulation.velocities).max()))
        deep.append(deepest(scene))
    assert deep[0] > 0.0035, "it is not thrown out in a tick"
    assert max(deep[100:]) < 1e-4, "but comes out"
    assert fastest < 1.3 * RECOVERY_SPEED, "pushed out in a substep it is 5.8 m/s; tissue between nodes gives way, too"
    assert is_sound(scene)


# external force --------------------------------------------------------------------------------
def test_external_force_dents_the_tissue_under_the_tip_and_is_not_in_the_wrench():
    organ = kidney()
    scene = Scene(organ, [PROBE])
    tip = top_of(organ) + [0.0, 0.0, 0.009]  # its ball does not touch
    for _ in range(150):
        scene.move(0, tip)
        scene.push(0, [0.0, 0.0, -0.1])
        scene.step()
    moved = scene.simulation.positions - organ.rest_positions
    assert moved[:, 2].min() < -5e-4
    deepest = organ.rest_positions[moved[:, 2].argmin()]
    assert np.linalg.norm((deepest - tip)[:2]) < 0.006, "the dent lies under the tip"
    np.testing.assert_array_equal(scene.wrenches, 0.0)
    for _ in range(1500):
        scene.move(0, tip)
        scene.step()
    assert scene.simulation.asleep
    assert np.abs(scene.simulation.positions - organ.rest_positions).max() < 1e-5


# rough use -------------------------------------------------------------------------------------
def test_two_jaws_nip_lift_and_let_go():
    """Across the upper pole, 18 mm wide at the jaws: 5 mm into either side, 4 mm up, open, away."""
    organ = kidney()
    scene = Scene(organ, [Tool("left", radius=0.004), Tool("right", radius=0.004)])
    middle = top_of(organ) + [0.0, 0.0, -0.005]

    def jaws(apart, up):
        for tool, sign in ((0, 1.0), (1, -1.0)):
            scene.move(tool, middle + [0.0, sign * (apart + 0.004), up])
        scene.step()
        assert is_finite(scene.simulation)

    for apart in np.linspace(0.012, 0.004, 100):
        jaws(apart, 0.0)
    before = scene.wrenches[:, 2].sum()
    for up in np.linspace(0.0, 0.004, 100):
        jaws(0.004, up)
    # The jaws are pushed apart, and down by what they lift.
    assert scene.wrenches[0, 1] > 0.04
    assert scene.wrenches[1, 1] < -0.04
    assert scene.wrenches[:, 2].sum() < before - 0.05
    for apart in np.linspace(0.004, 0.02, 100):
        jaws(apart, 0.004)
    np.testing.assert_array_equal(scene.wrenches, 0.0)
    for _ in range(900):
        jaws(0.1, 0.1)
    assert is_sound(scene)
    assert scene.simulation.asleep
    assert np.abs(scene.simulation.positions - organ.rest_positions).max() < 1e-5


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.extended)])
def test_tool_that_jumps_about_inside_and_out_leaves_nothing_that_is_not_finite(seed):
    organ = ball(2)
    scene = Scene(organ, [Tool("left", radius=0.006), Tool("right", "capsule", radius=0.003, length=0.05)])
    random = np.random.default_rng(seed)
    span = scene.simulation.settings.runaway_span
    for tick in range(600):
        for tool in range(2):
            if tick % 7 == 0:
                turn = random_turns(1, random)[0].as_quat()
                scene.move(tool, random.uniform(-0.05, 0.05, 3), turn)
        if tick % 50 == 0:
            scene.push(0, random.normal(0.0, 2.0, 3))
        scene.step()
        assert is_finite(scene.simulation)
        assert np.all(np.linalg.norm(scene.wrenches[:, :3], axis=1) <= 10.0 + 1e-9)
        assert np.abs(scene.simulation.positions - organ.rest_positions).max() <= span
    lead(scene, 0, [1.0, 0.0, 0.0], hold=5)
    lead(scene, 1, [1.0, 0.0, 0.0], hold=2500)
    assert scene.simulation.asleep, "the organ does not find back to rest"
    assert np.abs(scene.simulation.positions - organ.rest_positions).max() < 1e-5


def test_two_scenes_with_the_same_inputs_are_bit_identical():
    states = []
    for _ in range(2):
        scene = Scene(kidney(), [PROBE, Tool("right", "capsule", radius=0.003, length=0.04)])
        press(scene, 0.004, hold=30)
        lead(scene, 1, line([0.2, 0.0, 0.0], kidney().surface_positions[10], 60))
        states.append(scene.simulation.state.words.copy())
    np.testing.assert_array_equal(*states)
