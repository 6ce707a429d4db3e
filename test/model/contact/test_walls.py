"""How tools move where tissue is held: they stop there, and are resisted until they leave."""

import numpy as np
import pytest
import trimesh

from helpers.pressing import depths, lead, line
from helpers.scenes import RADIUS, ball_of_cells
from tissue_sim.contact.scene import Scene
from tissue_sim.contact.tools import Tool
from tissue_sim.handles import handle
from tissue_sim.model.contact.poses import distance_along_path, set_frame
from tissue_sim.model.contact.walls import MOVES, STEEPEST, STIFFNESS, WALL, depth_of_wall, find_walls, measure_walls

FOOT = np.array([0.0, 0.0, -RADIUS])  # of the ball, in the middle of its clamp


def tool_of(shape, folder):
    """A tool, and how far its origin lies from where it touches, m."""
    if shape == "sphere":
        return Tool("tool", radius=0.005), 0.005
    jaw = trimesh.creation.box((0.012, 0.012, 0.004))
    jaw.apply_translation([0.0, 0.0, -0.002])
    jaw.export(folder / "jaw.stl")
    return Tool("tool", shape="mesh", mesh=str(folder / "jaw.stl")), 0.0


def held_points(scene):
    """How deep, m, contact points that are held for the most part lie in a tool."""
    state, contacts = scene.simulation.state, scene.contacts
    free = ~np.isin(contacts.node, scene.simulation.organ.fixed)
    held = (free * contacts.weight).sum(axis=1) < MOVES
    points = np.einsum("ij,ijk->ik", contacts.weight, state.position[contacts.node])
    return depths(scene, points)[held]


@pytest.mark.parametrize("shape", ["sphere", "jaw"])
def test_a_tool_at_the_clamp_stops_there_and_is_resisted_until_it_leaves(tmp_path, shape):
    tool, ahead = tool_of(shape, tmp_path)
    scene = Scene(ball_of_cells(), [tool], ticks_a_set=4)
    outside, inside = (FOOT + [0.0, 0.0, deep - ahead] for deep in (-0.003, 0.012))
    force = lead(scene, 0, line(outside, inside, 150), hold=100)
    points = held_points(scene)
    assert len(points) > 5
    assert points.max() == pytest.approx(WALL * scene.tools.smallest[0], rel=1e-6)
    lag = scene.simulation.state.held_pose[0, 2] - scene.simulation.state.body_pose[0, 2]
    assert lag > 0.005
    assert -force[-1, 2] == pytest.approx(STIFFNESS * lag, rel=0.1)  # along the normals of points around
    assert np.ptp(force[-50:, 2]) < 0.05 * -force[-1, 2], "it doesn't shake"
    assert scene.simulation.state.count.slips == scene.simulation.state.count.faults == 0
    assert scene.simulation.state.status.backoff == 1
    assert not lead(scene, 0, line(inside, outside, 150), hold=50)[-1].any()


@pytest.mark.parametrize("radius", [0.005, 0.001])
def test_a_coupled_tool_at_the_clamp_is_held_by_its_spring(radius):
    """The bound on a small tool's way in a substep is none on its force."""
    scene = Scene(ball_of_cells(), [Tool("tool", radius=radius)])
    settings = scene.simulation.settings
    settings.coupling_stiffness, settings.coupling_damping = 300.0, 1.0
    force = lead(scene, 0, line(FOOT - [0.0, 0.0, 0.008], FOOT + [0.0, 0.0, 0.005], 300), hold=300)
    state = scene.simulation.state
    way = state.held_pose[0, :3] - state.body_pose[0, :3]
    assert way[2] > 0.005
    assert force[-1, 2] == pytest.approx(-300.0 * way[2], rel=0.05)
    np.testing.assert_allclose(force[-1, :2], -300.0 * way[:2], atol=0.15 * 300.0 * way[2])  # it slides between facets
    assert np.ptp(force[-50:, 2]) < 0.05 * -force[-1, 2], "it doesn't shake"


@pytest.mark.parametrize("shape", ["sphere", "jaw", "ring"])
def test_a_fixed_point_gets_no_deeper_than_the_tool_has_moved(tmp_path, shape):
    if shape == "ring":  # not convex: its distance is interpolated on a grid
        trimesh.creation.torus(0.008, 0.002).export(tmp_path / "ring.stl")
        tool, ahead = Tool("tool", shape="mesh", mesh=str(tmp_path / "ring.stl")), 0.002
    else:
        tool, ahead = tool_of(shape, tmp_path)
    scene = Scene(ball_of_cells(), [tool], ticks_a_set=4)
    lead(scene, 0, line(FOOT - [0.0, 0.0, 0.003 + ahead], FOOT + [0.0, 0.0, 0.001 - ahead], 60), hold=8)
    simulation, random = scene.simulation, np.random.default_rng(1)
    state, shapes, scratch = simulation.state, simulation.shapes, simulation.scratch
    held = handle(state), handle(shapes), handle(scratch)
    find_walls(handle(simulation.model), held[0], held[2])
    assert scratch.n_walls[0] > 5
    measure_walls(*held)
    before, own = state.body_pose[0].copy(), scratch.wall_depth[: scratch.n_walls[0]].copy()
    for _ in range(40):
        turn = random.normal(0.0, 0.1, 4)
        state.body_pose[0, :3] = before[:3] + random.normal(0.0, 0.002, 3)
        state.body_pose[0, 3:] = (before[3:] + turn) / np.linalg.norm(before[3:] + turn)
        moved = STEEPEST * distance_along_path(before, state.body_pose[0], shapes.extent[0])
        set_frame(state.body_pose[0], scratch.origin[0], scratch.rotation[0])
        for index, deep in enumerate(own):
            now = depth_of_wall(*held, scratch.wall[index])
            assert not np.isfinite(deep) or now <= deep + moved
