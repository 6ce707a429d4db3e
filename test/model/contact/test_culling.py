"""Which contact points a tick looks at: all that the tools' way or fast tissue can bring to them, by a naive twin."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from helpers.scenes import ball
from tissue_sim.contact.scene import Scene
from tissue_sim.contact.tools import Tool
from tissue_sim.handles import handle
from tissue_sim.model.contact.culling import FAST, cull_contacts
from tissue_sim.model.contact.poses import set_frame
from tissue_sim.model.contact.tool_motion import MAX_CATCH_UP_SPEED

RADIUS, HALF = 0.004, 0.01  # m, of a capsule
ORGAN = ball(3)


def scene_at(gap):
    """A capsule that lies on the organ's top, so far from it, m, after ticks in which it was found."""
    scene = Scene(ORGAN, [Tool("probe", "capsule", radius=RADIUS, length=2.0 * HALF)])
    top = ORGAN.surface_positions[:, 2].max()
    for height in np.linspace(0.01, gap, 40):
        scene.move(0, [0.0, 0.0, top + RADIUS + height], Rotation.from_euler("x", 80.0, degrees=True).as_quat())
        scene.step()
    return scene


def in_capsule(state, entries, pose):
    """Contact points (k, 3) m in the frame of a capsule."""
    points = np.einsum("kc,kcx->kx", state.contacts.weight[entries], state.position[state.contacts.node[entries]])
    return Rotation.from_quat(pose[3:]).inv().apply(points - pose[:3])


def capsule_gap(state, entries, pose):
    """Their distances (k,) m to it."""
    local = in_capsule(state, entries, pose)
    along = np.clip(local[:, 2], -2.0 * HALF, 0.0)
    return np.linalg.norm(local - np.stack([0 * along, 0 * along, along], axis=1), axis=1) - RADIUS


def naive_watch(state, goal, tick_time, coupling):
    """Entries (k,) that are pressed, or whose distance to the capsule is within what this tick can close."""
    header, pose = state.contacts.header, state.body_pose[0]
    turn, end = Rotation.from_quat(pose[3:]), Rotation.from_quat(goal[3:])
    entries = np.arange(header.points)
    local, gap = in_capsule(state, entries, pose), capsule_gap(state, entries, pose)
    moved = np.linalg.norm(goal[:3] - pose[:3]) * min(1.0, coupling)
    turned = np.linalg.norm(end.as_matrix() - turn.as_matrix())
    most = MAX_CATCH_UP_SPEED * tick_time if coupling == 1.0 else np.inf
    reach = np.minimum(most, moved + turned * np.linalg.norm(local, axis=1)) + FAST * tick_time
    return np.flatnonzero((state.contact_pressed[0, : header.points] > 0.0) | (gap < reach))


@pytest.mark.parametrize("way", [0.0, 0.001])
@pytest.mark.parametrize(("stiffness", "led"), [(0.0, 1.0), (300.0, 0.3)])
@pytest.mark.parametrize("gap", [0.0002, -0.002])
def test_what_may_touch_is_watched_and_the_rest_forgotten(gap, stiffness, led, way):
    scene = scene_at(gap)
    simulation = scene.simulation
    state, settings, scratch = simulation.state, simulation.settings, simulation.scratch
    settings.coupling_stiffness, settings.coupling_damping = stiffness, 1.0
    goal = state.body_pose[0] + [0.0, 0.0, -way, 0.0, 0.0, 0.0, 0.0]
    goal[3:] = (Rotation.from_quat(goal[3:]) * Rotation.from_rotvec([0.0, 10.0 * way, 0.0])).as_quat()
    set_frame(goal, scratch.origin[0], scratch.rotation[0])
    expected = naive_watch(state, goal, settings.tick_time, led)
    state.contact_held[0] = 1.0
    cull_contacts(handle(state), handle(simulation.shapes), settings, handle(scratch))
    count = int(scratch.n_candidates[0])
    points = int(state.contacts.header.points)
    assert 0 < count < points
    np.testing.assert_array_equal(scratch.candidates[:count], expected)
    others = np.setdiff1d(np.arange(points), expected)
    assert not np.any(state.contact_held[0, others])
    assert np.all(state.contact_held[0, expected] == 1.0)


def test_what_is_left_of_a_gap_is_no_more_than_there_is():
    """Points are looked at again when this is used up, by the tissue's speed here, substep by substep."""
    scene = scene_at(0.0008)
    simulation = scene.simulation
    state, scratch = simulation.state, simulation.scratch
    above = np.argsort(-ORGAN.surface_positions[:, 2])[:30]
    seen = 0
    for tick in range(-300, 200):  # what the tool's coming has moved has died down by then
        pull = 0.0 if tick < 0 else 0.0005 * np.sin(2.0 * np.pi * 0.02 * tick)
        simulation.apply_force(above, np.tile([0.0, 0.0, pull], (len(above), 1)))
        scene.move(0, state.body_pose[0, :3], state.body_pose[0, 3:])
        simulation.step()
        if tick < 0:
            continue
        count = int(scratch.n_candidates[0])
        gap = capsule_gap(state, scratch.candidates[:count], state.body_pose[0])
        assert state.status.touching == 0
        assert np.all(scratch.candidate_gap[:count] <= gap + 1e-9)
        seen += np.count_nonzero(scratch.candidate_gap[:count] < gap - 1e-9)
    assert seen > 500
