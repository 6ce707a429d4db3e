"""How an organ that nobody touches comes to rest: asleep at rest, to the last bit, from wherever it was left."""

import numpy as np
import pytest

from helpers.kernels import by_reference
from helpers.scenes import ball, ball_of_cells, changed, kidney
from tissue_sim.model.regions.moved_nodes import largest_motion
from tissue_sim.model.simulation import Simulation
from tissue_sim.model.stepping.rest_recovery import (
    INVERTED_TIME,
    LONGEST_RETURN,
    QUIET_TICKS,
    RECOVERY_DISPLACEMENT,
    return_rate,
    sleep_or_recover,
)


def awake(organ, **options):
    simulation = Simulation(organ, **options)
    simulation.state.status.asleep = False
    return simulation


def pace_of(simulation):
    world = by_reference(simulation)
    return return_rate(world.model, world.settings)


def settles(simulation, ticks=1500):
    """Ticks until the organ is asleep, at rest exactly."""
    taken = 0
    while taken < ticks and not simulation.asleep:
        simulation.step()
        taken += 1
    assert simulation.asleep
    np.testing.assert_array_equal(simulation.positions, simulation.model.rest)
    np.testing.assert_array_equal(simulation.velocities, 0.0)
    assert simulation.state.status.turned == 0
    return taken


def test_largest_motion_is_that_of_a_naive_loop():
    simulation = Simulation(ball())
    model, state = simulation.model, simulation.state
    random = np.random.default_rng(0)
    state.position[:] = model.rest + random.standard_normal(model.rest.shape)
    state.velocity[:] = random.standard_normal(model.rest.shape)
    nodes = model.moving
    world = by_reference(simulation)
    speed, away = largest_motion(world.model, world.state, world.scratch)
    assert speed == np.abs(state.velocity[nodes]).max()
    assert away == np.abs(state.position - model.rest)[nodes].max()


SLACK = changed(ball(2), spring_stiffness=0.0, angular_stiffness=0.0, return_stiffness=0.0)


def test_slack_organ_left_aside_is_led_back():
    """Nothing pulls it to rest: a false rest shape in its purest form, every cell the right way round."""
    simulation = awake(SLACK)
    state, nodes = simulation.state, simulation.model.moving
    state.position[nodes, 0] += 0.002
    state.good_position[:] = state.position
    still = state.position.copy()
    for _ in range(max(QUIET_TICKS, int(1e3 / pace_of(simulation)) + 1) - 1):
        simulation.step()
    np.testing.assert_array_equal(simulation.positions, still)
    assert state.count.snaps == 0
    simulation.step()
    assert state.status.snapped
    assert settles(simulation) < 500
    assert state.count.snaps == 1
    assert state.count.faults == 0


def test_a_slow_organ_goes_back_at_its_own_pace():
    """Times as heavy as the square of its slowness it does the same in so many times the time, from standing still."""
    organ, moved = ball(2), []
    for slowness in (5.0, 50.0):
        simulation = Simulation(changed(organ, mass=slowness**2, damping=slowness))
        simulation.settle(np.broadcast_to([4e-3, 0.0, 0.0], (organ.n_surface, 3)), 1e-3, 50.0)
        away = np.abs(simulation.positions - simulation.model.rest).max()
        assert away > 5e-4
        for _ in range(round(15 * slowness)):
            simulation.step()
        assert simulation.state.count.snaps == 0
        moved.append(np.abs(simulation.positions - simulation.model.rest).max() / away)
    assert moved[1] == pytest.approx(moved[0], abs=0.02)


def test_load_keeps_an_organ_that_stands_still_away_from_rest_where_it_is():
    simulation = Simulation(ball(2))
    node = int(np.argmax(ball(2).surface_positions[:, 2]))
    for _ in range(1200):
        simulation.apply_force(node, [0.0, 0.0, -0.1])
        simulation.step()
    assert np.abs(simulation.velocities).max() < 1e-6
    assert simulation.state.count.snaps == 0
    assert not simulation.state.status.snapped
    assert np.abs(simulation.positions - simulation.model.rest).max() > 5e-4
    settles(simulation)
    assert simulation.state.count.snaps == 0, "a sound organ finds back by itself"


def test_an_organ_that_sags_is_set_up_anew_once_after_a_fault():
    simulation = Simulation(ball(2))
    simulation.settings.gravity_z = -9.81
    state, count = simulation.state, simulation.state.count
    for _ in range(3000):
        simulation.step()
    sagged = simulation.positions.copy()
    assert np.abs(sagged - simulation.model.rest).max() > RECOVERY_DISPLACEMENT
    assert count.snaps == 0
    state.status.faulted = True
    farthest = 0.0
    for _ in range(6000):
        simulation.step()
        farthest = max(farthest, float(np.abs(simulation.positions - sagged).max()))
    assert count.snaps == 1
    assert farthest > 0.9 * np.abs(sagged - simulation.model.rest).max(), "it was at rest without weight"
    np.testing.assert_allclose(simulation.positions, sagged, atol=1e-6)


@pytest.mark.parametrize(
    ("weight", "turned", "stiff", "speed", "led_back"),
    [
        (0.0, 0, 0, 0.1, False),
        (0.0, 0, 5, 0.0, True),
        (9.81, 0, 5, 0.0, False),
        (9.81, 0, 5, 0.1, True),
        (9.81, 3, 0, 0.0, True),
    ],
)
def test_an_organ_that_is_pulled_is_led_back_where_it_can_not_be_right_for_long(weight, turned, stiff, speed, led_back):
    """Of cells: inside out or squeezed; it may move, or lie squeezed by its weight."""
    simulation = awake(ball_of_cells(), model="cells")
    state, model, settings, scratch = simulation.state, simulation.model, simulation.settings, simulation.scratch
    world = by_reference(simulation)
    settings.gravity_z = -weight
    longest = LONGEST_RETURN / (pace_of(simulation) * settings.tick_time)
    state.position[model.moving, 2] += 1e-3
    state.velocity[model.moving, 2] = speed
    state.status.turned, model.tissue.stiff[0], scratch.plan.forced = turned, stiff, True
    for share, snapped in ((0.99, False), (1.01, led_back)):
        state.status.alone = round(share * longest)
        sleep_or_recover(world.model, world.state, world.settings, world.scratch)
        assert state.status.snapped == snapped


@pytest.mark.parametrize("organ", [ball(2), kidney()], ids=["ball", "kidney"])
def test_cap_pushed_through_the_organ_is_at_rest_soon(organ):
    simulation = awake(organ)
    state, model = simulation.state, simulation.model
    middle = model.rest[model.moving].mean(axis=0)
    offset = model.rest - middle
    cap = (offset[:, 0] > 0.5 * offset[:, 0].max()) & (model.inverse_mass > 0.0)
    assert 0.03 < cap.mean() < 0.4
    state.position[cap, 0] -= 2.0 * offset[cap, 0]
    state.good_position[:] = state.position
    settles(simulation, 1000)


def test_inside_may_be_turned_for_a_moment_before_it_is_led_back():
    """With nothing to bring it back by itself, the organ is taken after INVERTED_TIME, not before."""
    simulation = awake(changed(SLACK, damping=0.0))
    state, model = simulation.state, simulation.model
    state.position[model.moving, 2] *= -1.0
    state.velocity[model.moving] = [0.1, 0.0, 0.0]  # so that it is not the stillness that tells
    state.good_position[:] = state.position
    # A third of it the right way round, so that it isn't collapsed.
    upright = model.moving[model.rest[model.moving, 0] < 0.002]
    state.position[upright] = state.good_position[upright] = model.rest[upright]
    begun = None
    for tick in range(400):
        simulation.step()
        if begun is None and state.status.snapped:
            begun = tick
    assert state.count.faults == 0
    assert begun is not None
    assert begun * 1e-3 == pytest.approx(INVERTED_TIME, abs=0.003)
    settles(simulation)


def test_a_slow_organ_has_not_settled_while_it_creeps():
    """A heavy and tough organ is still on its way where the force that is left, spread over its nodes, is small."""
    organ = ball(2)
    forces = np.zeros((organ.n_surface, 3))
    forces[int(np.argmax(organ.surface_positions[:, 2]))] = [2e-3, 0.0, 0.0]
    quick, settled = Simulation(organ).settle(forces, 1e-4, 20.0)
    slow, settled_too = Simulation(changed(organ, mass=1e4, damping=1e2)).settle(forces, 1e-4, 200.0)
    assert settled
    assert settled_too
    assert np.linalg.norm(slow - quick) < 2e-3 * np.linalg.norm(quick)


@pytest.mark.extended
def test_an_organ_that_trembles_far_from_rest_for_good_is_led_back():
    """Neither still nor on its way: what is not back long after a sound one would be goes to sleep all the same."""
    simulation = awake(changed(SLACK, damping=0.0))
    state, model = simulation.state, simulation.model
    longest = LONGEST_RETURN / (pace_of(simulation) * simulation.settings.tick_time)
    for tick in range(round(longest) + 5):
        state.position[model.moving] = model.rest[model.moving]
        state.position[model.moving, 2] += 1e-3
        state.velocity[model.moving] = [0.0, 0.0, 0.1 * (-1.0) ** tick]
        assert not state.status.snapped, tick
        simulation.step()
        if state.status.snapped:
            break
    assert abs(tick - longest) <= 3
    assert state.count.faults == 0
    settles(simulation)


@pytest.mark.extended
def test_an_undamped_organ_swings_on():
    simulation = awake(changed(SLACK, damping=0.0))
    state, model, settings = simulation.state, simulation.model, simulation.settings
    settings.damping_scale = 0.0
    for tick in range(round(1.2 * LONGEST_RETURN / (pace_of(simulation) * settings.tick_time))):
        state.position[model.moving] = model.rest[model.moving]
        state.position[model.moving, 2] += 1e-3
        state.velocity[model.moving] = [0.0, 0.0, 0.1 * (-1.0) ** tick]
        simulation.step()
    assert state.count.snaps == 0
