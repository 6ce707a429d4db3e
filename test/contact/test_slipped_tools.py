"""Tools that are pressed deeper than the surface can bear: held on their side, with a steady force, and free again."""

import numpy as np
import pytest

from helpers.scenes import RADIUS, ball
from tissue_sim.bench.presses import Form, Motion, locations_on
from tissue_sim.contact.scene import Scene
from tissue_sim.contact.tools import Tool
from tissue_sim.model.contact.tool_motion import MAX_FAST_SLIPS
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.shipped import shipped_organ

START = 0.036  # m, above the ball
ASIDE = np.array([0.001, 0.002])  # m from its axis


def press(scene, heights):
    """Move the tool through heights (k,) m; its forces (k, 3) N, where it was (k, 3) m, and whether inside (k,)."""
    forces, places, inside = [], [], []
    state = scene.simulation.state
    for height in heights:
        scene.move("left", (*ASIDE, height))
        scene.step()
        forces.append(scene.wrench("left")[:3].copy())
        places.append(state.body_pose[0, :3].copy())
        inside.append(scene.finder._swallowed(0, scene.simulation.positions, state.body_pose[0, :3]) is not None)
    return np.array(forces), np.array(places), np.array(inside)


def ways(speed):
    """Heights on the way down through the whole ball, and back, m; speed m/s."""
    return np.arange(START, -0.05, -1e-3 * speed), np.arange(-0.05, START, 1e-4)


def longest(mask):
    """Return the length of the longest run of True in a mask (k,)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(int), [0]])))
    return int((edges[1::2] - edges[::2]).max(initial=0))


@pytest.mark.parametrize(("radius", "speed"), [(0.003, 0.2), (0.005, 0.2), (0.005, 0.05)])
def test_a_tool_pressed_through_the_organ_is_held_on_its_side_and_is_free_again(radius, speed):
    scene = Scene(ball(2), [Tool("left", radius=radius)])
    state, (down, up) = scene.simulation.state, ways(speed)
    forces, places, inside = press(scene, down)
    assert state.count.slips > 0
    sizes = np.linalg.norm(forces, axis=1)
    beyond = down < -RADIUS - radius  # the hand is in the air again, on the far side
    assert places[beyond, 2].min() > 0.0, "the tool is above the middle"
    assert sizes[beyond].min() > 0.3 * sizes.max()
    assert np.ptp(forces[beyond], axis=0).max() < 0.02 * sizes.max(), "steady"
    assert forces[beyond, 2].min() > 0.8 * sizes[beyond].min(), "upwards"
    assert longest(inside) < 10, "ticks until it is back on the surface, which swings back at first"
    back, places, _ = press(scene, up)
    assert np.linalg.norm(back, axis=1).max() < sizes.max()
    assert np.abs(back[-1]).max() == 0.0
    assert np.allclose(places[-1], (*ASIDE, up[-1]))
    assert state.bodies[0].slips == 0


def test_a_tool_that_had_slipped_presses_as_before_once_it_has_been_outside():
    heights = np.concatenate([np.full(200, START), np.arange(START, 0.025, -1e-4), np.full(200, 0.025)])
    fresh, slipped = (Scene(ball(2), [Tool("left", radius=0.005)]) for _ in range(2))
    for way in ways(0.2):
        press(slipped, way)
    assert slipped.simulation.state.count.slips > 0
    wanted, found = press(fresh, heights)[0][-1], press(slipped, heights)[0][-1]
    assert np.linalg.norm(wanted) > 0.5
    assert np.allclose(found, wanted, rtol=0.01, atol=0.005)


@pytest.mark.parametrize("speed", [0.8, 5.0])
def test_a_tool_that_slips_from_haste_then_presses_as_a_slow_one_does(speed):
    organ, form, sizes = Organ.load(shipped_organ("kidney")), Form("", (), 0.002, 0.002), []
    place = locations_on(organ, 2)[1]
    for motion in (Motion(0.02, 1000.0), Motion(speed, 1000.0)):
        scene = Scene(organ, [Tool("left", radius=form.radius)], ticks_a_set=3)
        for depth in motion.depths(form.depth):
            scene.move("left", place.pose(form, depth)[:3])
            scene.step()
        sizes.append(np.linalg.norm(scene.wrench("left")[:3]))
    assert scene.simulation.state.count.slips > 0
    assert sizes[1] == pytest.approx(sizes[0], rel=0.1), "N; not held at less"


def test_the_shorter_substeps_after_a_slip_end_while_the_organ_is_awake():
    scene = Scene(ball(2), [Tool("left", radius=0.003)])
    state, substeps, outside = scene.simulation.state, scene.simulation.settings.substeps, RADIUS + 0.0036
    press(scene, ways(0.2)[0])
    assert state.bodies[0].slips > 0
    assert state.status.substeps == 2 * substeps
    press(scene, [*np.arange(-0.05, outside, 1e-3), *np.linspace(outside, outside - 0.002, 30)])
    assert state.bodies[0].slips == 0
    assert np.abs(scene.wrench("left")).max() > 0.0
    assert state.status.substeps == substeps


def test_released_poses_end_the_hold():
    scene = Scene(ball(2), [Tool("left", radius=0.005)])
    press(scene, ways(0.2)[0])
    assert scene.simulation.state.bodies[0].slips > 1
    settings = scene.simulation.settings
    for _ in range(round((settings.stale_time + settings.ramp_time) / settings.tick_time) + 5):
        scene.step()
    assert scene.simulation.state.bodies[0].slips == 0
    assert np.abs(scene.wrench("left")).max() == 0.0


@pytest.mark.parametrize("stiffness", [500.0, 2000.0])
def test_a_coupled_tool_that_has_slipped_is_held_without_oscillating(stiffness):
    scene = Scene(ball(2), [Tool("left", radius=0.005)], ticks_a_set=4)
    state, settings = scene.simulation.state, scene.simulation.settings
    settings.coupling_stiffness, settings.coupling_damping = stiffness, 1.0
    press(scene, ways(0.05)[0])
    assert state.bodies[0].slips > MAX_FAST_SLIPS
    held, _, _ = press(scene, np.full(1500, ways(0.05)[0][-1]))
    sizes = np.linalg.norm(held[-500:], axis=1)
    assert np.ptp(held[-500:], axis=0).max() < 0.02, "N"
    assert sizes.min() > 0.5 * state.bodies[0].bearable
    assert sizes.max() < 1.05 * state.bodies[0].bearable


@pytest.mark.parametrize("slip", [1, 2])
def test_a_set_that_was_found_before_a_tool_was_put_back_moves_it_no_more(slip):
    scene = Scene(ball(2), [Tool("left", radius=0.005)])
    state = scene.simulation.state
    heights = iter(ways(0.05)[0])
    while state.count.slips < slip:
        scene.move("left", (*ASIDE, next(heights)))
        scene.step()
    late, place, reach = scene.contacts, state.body_pose.copy(), state.contacts.reach.copy()
    scene.simulation.take_contacts(late, 1000)
    np.testing.assert_array_equal(state.body_pose, place)
    np.testing.assert_array_equal(state.contacts.reach, reach)
    assert state.count.slips == slip
    scene.step()
    assert state.bodies[0].engaged, "the next set holds it again"


def test_a_hand_that_resumes_inside_is_put_on_the_surface_and_presses_on():
    scene = Scene(ball(2), [Tool("left", radius=0.003)])
    state, settings = scene.simulation.state, scene.simulation.settings
    press(scene, np.arange(START, 0.024, -1e-4))
    pause = round((settings.stale_time + settings.ramp_time) / settings.tick_time) + 20
    for _ in range(pause):
        scene.step()
    assert state.bodies[0].released
    assert scene.finder._swallowed(0, scene.simulation.positions, state.body_pose[0, :3]) is not None
    forces, _, inside = press(scene, np.full(300, 0.024))
    assert state.bodies[0].engaged
    assert not state.bodies[0].held_off
    assert not inside[-200:].any()
    assert forces[-200:, 2].min() > 0.1, "N"
    assert state.bodies[0].slips <= MAX_FAST_SLIPS, "it is not held at less"
