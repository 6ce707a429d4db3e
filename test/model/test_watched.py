"""Which contact points a tick looks at: all that the tools' way or fast tissue can bring to them, by a naive twin."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from helpers.scenes import ball
from tissue_sim.contact.scene import Scene
from tissue_sim.contact.tools import Tool
from tissue_sim.jit import handle
from tissue_sim.model.tool_motion import set_frame
from tissue_sim.model.watched import FAST, watch_contacts

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


def naive_watch(state, goal, tick_time, coupling):
    """Entries (k,) that are pressed, or whose distance to the capsule is within what this tick can close."""
    header, pose = state.contacts.header, state.body_pose[0]
    nodes, weights = state.contacts.node[: header.points], state.contacts.weight[: header.points]
    points = np.einsum("kc,kcx->kx", weights, state.position[nodes])
    turn, end = Rotation.from_quat(pose[3:]), Rotation.from_quat(goal[3:])
    local = turn.inv().apply(points - pose[:3])
    along = np.clip(local[:, 2], -2.0 * HALF, 0.0)
    gap = np.linalg.norm(local - np.stack([0 * along, 0 * along, along], axis=1), axis=1) - RADIUS
    moved = np.linalg.norm(goal[:3] - pose[:3]) * min(1.0, coupling)
    turned = np.linalg.norm(end.as_matrix() - turn.as_matrix())
    reach = moved + turned * np.linalg.norm(local, axis=1) + FAST * tick_time
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
    watch_contacts(handle(state), handle(simulation.shapes), settings, handle(scratch))
    count = int(scratch.watching[0])
    points = int(state.contacts.header.points)
    assert 0 < count < points
    np.testing.assert_array_equal(scratch.watched[:count], expected)
    others = np.setdiff1d(np.arange(points), expected)
    assert not np.any(state.contact_held[0, others])
    assert np.all(state.contact_held[0, expected] == 1.0)
