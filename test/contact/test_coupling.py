"""The virtual coupling between hand and tool, the slew limit, and the passivity bound with a device in the loop."""

import numpy as np
import pytest

from helpers.pressing import PROBE, deepest, is_sound, lead, line, press, top_of
from helpers.scenes import RADIUS, ball, free_ball, kidney
from tissue_sim.contact.scene import Scene
from tissue_sim.contact.tools import Tool
from tissue_sim.model.contact.virtual_coupling import passive_stiffness
from tissue_sim.organ.placement import placed

STIFFNESS, DAMPING = 500.0, 1.0  # N/m, N s/m


def coupled(organ, stiffness=STIFFNESS, damping=DAMPING, tool=PROBE):
    scene = Scene(organ, [tool])
    scene.simulation.settings.coupling_stiffness = stiffness
    scene.simulation.settings.coupling_damping = damping
    return scene


def apart(scene):
    """Where the tool is less where the hand is, (3,) m."""
    state = scene.simulation.state
    return state.body_pose[0, :3] - state.held_pose[0, :3]


def test_hand_at_rest_feels_the_coupling_spring():
    scene = coupled(kidney())
    forces = press(scene, 0.005, hold=600)
    assert forces[-1, 2] > 0.1
    np.testing.assert_allclose(STIFFNESS * apart(scene), forces[-1], rtol=1e-3, atol=1e-4)
    assert deepest(scene) < 2e-4, "the tool itself stays out of the tissue"
    assert is_sound(scene)


def test_a_spring_presses_with_all_its_force_however_far_the_hand_is():
    """The bound on a tool's way in a step is none on the force of a spring that contact holds back."""
    scene = coupled(ball(2), 200.0, 1.0, Tool("left", radius=0.01))
    scene.simulation.settings.stiffness_scale = 100.0
    scene.simulation.set_substeps()
    forces = press(scene, 0.02, hold=300)
    np.testing.assert_allclose(200.0 * apart(scene), forces[-1], rtol=1e-2, atol=1e-3)
    assert forces[-1, 2] > 2.0, "N"
    assert is_sound(scene)


def test_pressing_with_one_tool_moves_no_other():
    """Where all give way: one in the air stays where its hand is, and others give way to their own forces alone."""
    scene = Scene(kidney(), [PROBE, Tool("right", radius=0.005), Tool("third", radius=0.005)])
    scene.simulation.settings.coupling_stiffness, scene.simulation.settings.coupling_damping = STIFFNESS, DAMPING
    surface = kidney().surface_positions
    places = top_of(kidney()), surface[np.argmax(surface[:, 0])], np.array([0.0, 0.0, 0.3])
    ways = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    for height in [*np.linspace(0.006, 0.0, 200), *[0.0] * 600]:
        for tool, (place, way) in enumerate(zip(places, ways, strict=True)):
            scene.move(tool, place + height * way)
        scene.step()
    state = scene.simulation.state
    moved = state.body_pose[:, :3] - state.held_pose[:, :3]
    np.testing.assert_array_equal(moved[2], 0.0)
    assert np.linalg.norm(scene.wrenches[:2, :3], axis=1).min() > 0.02, "N: both press"
    np.testing.assert_allclose(STIFFNESS * moved[:2], scene.wrenches[:2, :3], rtol=1e-3, atol=1e-4)


def test_tool_that_nothing_holds_is_where_its_hand_is():
    scene = coupled(kidney())
    lead(scene, 0, line([0.2, 0.0, 0.0], [0.2, 0.01, 0.0], 20))
    np.testing.assert_array_equal(apart(scene), 0.0)


def test_coupling_takes_the_kick_out_of_a_blow():
    """A hand that comes at 0.5 m/s: the same force in the end, and less on the way."""
    rigid, soft = Scene(kidney(), [PROBE]), coupled(kidney())
    hard, softened = (press(scene, 0.004, ticks=12, hold=500) for scene in (rigid, soft))
    assert np.abs(softened).max() < 0.8 * np.abs(hard).max()
    ratio = softened[-1, 2] / hard[-1, 2]
    assert 0.3 < ratio < 1.0, "softer by what the spring gives way"


def test_wrench_is_minus_what_the_tissue_gets_also_through_a_coupling():
    """Nothing but the contact changes the momentum of a free ball."""
    organ = free_ball(2)
    scene, mass = coupled(organ), organ.mass[:, None]
    got = np.zeros(3)
    for position in line(top_of(organ) + [0.0, 0.0, 0.010], top_of(organ) + [0.0, 0.0, 0.006], 20):
        before = (mass * scene.simulation.state.velocity).sum(axis=0)
        scene.move(0, position)
        scene.step()
        got = (mass * scene.simulation.state.velocity).sum(axis=0) - before
        np.testing.assert_allclose(scene.wrenches[0, :3], -got / 1e-3, atol=1e-9)
    assert np.abs(got).max() > 0.0
    assert np.isfinite(scene.simulation.state.position).all()


def test_force_changes_no_faster_than_the_slew_limit():
    free, slow = Scene(kidney(), [PROBE]), Scene(kidney(), [PROBE])
    free.simulation.settings.force_slew, slow.simulation.settings.force_slew = 1e6, 20.0
    whole, limited = (press(scene, 0.005, ticks=20, hold=400) for scene in (free, slow))
    assert np.linalg.norm(np.diff(whole, axis=0), axis=1).max() > 0.03
    assert np.linalg.norm(np.diff(limited, axis=0), axis=1).max() <= 20.0 * 1e-3 + 1e-12
    np.testing.assert_allclose(limited[-1], whole[-1], atol=1e-3)
    assert slow.simulation.state.count.slewed_ticks > 0
    assert free.simulation.state.count.slewed_ticks == 0
    # The slew limit holds nothing up when poses stop.
    for _ in range(75):
        slow.step()
    np.testing.assert_array_equal(slow.wrenches, 0.0)


def test_a_force_comes_down_no_faster_than_the_slew_limit_where_the_organ_is_at_rest_before():
    """Its sleep cut off what was left of the force in one tick."""
    scene = Scene(ball(2), [Tool("left", radius=0.005)])
    scene.simulation.settings.force_slew = slew = 0.1
    place = top_of(ball(2))  # where the tool is 5 mm deep
    forces = []
    for height in [*np.linspace(0.006, 0.0, 60), *[0.0] * 2000, *[0.02] * 4000]:
        scene.move("left", place + [0.0, 0.0, height])
        scene.step()
        forces.append(scene.wrench("left")[:3])
    sizes = np.linalg.norm(forces, axis=1)
    assert sizes[2059] > 0.1
    assert np.linalg.norm(np.diff(forces, axis=0), axis=1).max() <= slew * 1e-3 + 1e-12
    assert sizes[-1] == 0.0
    assert scene.simulation.asleep


def test_the_slew_limit_holds_for_the_sum_over_organs():
    """Each had the whole of it, so that a tool between two felt twice as fast a change."""
    balls = [ball(2), placed(ball(2), [2.1 * RADIUS, 0.0, 0.0])]
    scene, slew = Scene(balls, [Tool("left", radius=0.01)]), 10.0
    for one in scene.simulations:
        one.settings.force_slew = slew
    forces, own = [], []
    for height in [*np.linspace(0.02, 0.01, 40), *[0.01] * 300, *np.linspace(0.01, 0.03, 40)]:
        scene.move("left", [1.05 * RADIUS, 0.0, height])
        scene.step()
        forces.append(scene.wrench("left")[:3])
        own.append([np.linalg.norm(one.state.wrench[0, :3]) for one in scene.simulations])
    assert np.max(own, axis=0).min() > 0.1, "N: it touches both"
    rates = 1e3 * np.linalg.norm(np.diff(forces, axis=0), axis=1)
    assert rates.max() <= slew + 1e-9
    assert all(one.state.count.slewed_ticks > 0 for one in scene.simulations)


# a device in the loop --------------------------------------------------------------------------
DEVICE_MASS, DEVICE_DAMPING = 0.1, 1.0  # kg, N s/m


def bounce(stiffness, damping=0.2, seconds=1.5):
    """A device of some mass and damping, pushed with 0.5 N onto stiff tissue: its largest speeds, m/s, early and late.

    The force that moves it in a tick is the one published with its last pose, as over topics.
    """
    organ = ball(2)
    scene = coupled(organ, stiffness, damping, Tool("left", radius=0.01))
    scene.simulation.settings.stiffness_scale = 100.0
    scene.simulation.settings.force_slew = 1e6
    scene.simulation.set_substeps()
    place, speed, force = top_of(organ) + [0.0, 0.0, 0.0105], np.zeros(3), np.zeros(3)
    speeds = []
    for _ in range(round(1e3 * seconds)):
        for _ in range(10):  # the device itself, between two samples
            speed = speed + 1e-4 * ([0.0, 0.0, -0.5] + force - DEVICE_DAMPING * speed) / DEVICE_MASS
            place = place + 1e-4 * speed
        force = scene.wrenches[0, :3].copy()
        scene.move(0, place)
        scene.step()
        speeds.append(np.linalg.norm(speed))
    assert is_sound(scene)
    return max(speeds[400:800]), max(speeds[-400:])


@pytest.mark.extended
def test_device_within_the_passive_stiffness_comes_to_rest_and_far_beyond_it_does_not():
    bound = passive_stiffness(DEVICE_DAMPING, 1e-3, 2e-3)
    assert bound == pytest.approx(DEVICE_DAMPING / (0.5e-3 + 2e-3))
    early, late = bounce(0.5 * bound)
    assert late < 0.5 * early
    early, late = bounce(4.0 * bound)
    assert late > 0.9 * early > 1e-3, "the bound would not bind"


def test_unknown_damping_has_no_bound():
    assert passive_stiffness(0.0, 1e-3, 1e-3) == np.inf


def test_tools_with_a_coupling_are_led_like_those_without_when_nothing_is_touched():
    scene = coupled(kidney())
    lead(scene, 0, line([0.2, 0.0, 0.0], [0.25, 0.0, 0.0], 50))
    np.testing.assert_allclose(scene.simulation.state.body_pose[0, :3], [0.25, 0.0, 0.0], atol=1e-9)
