"""A step that has become too long under load is noticed within some ticks, and halved."""

import numpy as np
import pytest

from helpers.scenes import ball, filled
from helpers.slabs import INCISION, slab
from tissue_sim.contact.scene import Scene
from tissue_sim.handles import handle
from tissue_sim.model.simulation import Simulation
from tissue_sim.model.stepping.critical_step import model_step
from tissue_sim.model.stepping.mass_scaling import is_mass_scaled
from tissue_sim.model.stepping.oscillation import (
    HALVED_GROWTH,
    HALVED_TICKS,
    MAX_HALVED_TICKS,
    MIN_COORDINATES,
    MIN_SPEED,
    MIN_SPEED_AGAIN,
    count_oscillating,
    end_oscillation_check,
    is_oscillation_checked,
)
from tissue_sim.model.stepping.tick import substep_factor
from tissue_sim.organ.cell_mesh import with_cells

ORGAN = with_cells(filled(ball(2), 20), (1.0, 1.0))


def soft(share, substeps=1):
    """A simulation of so many substeps a tick, which are `share` of the critical step."""
    simulation = Simulation(ORGAN, substeps=substeps)
    settings = simulation.settings
    wanted = 1e-3 / substeps / share
    scale = 1.0
    for _ in range(20):
        scale *= (model_step(simulation.model, simulation.frequency, scale) / wanted) ** 2
    settings.stiffness_scale = scale
    return simulation


def after_a_push(simulation, ticks):
    rng = np.random.default_rng(0)
    nodes = simulation.model.moving[simulation.model.moving < ORGAN.n_surface]
    for _ in range(10):
        simulation.apply_force(nodes, 1e-4 * rng.standard_normal((len(nodes), 3)))
        simulation.step()
    substeps, speeds = [], []
    for _ in range(ticks):
        simulation.apply_force(nodes[:1], [0.0, 0.0, -1e-5])  # so that it stays awake
        simulation.step()
        substeps.append(int(simulation.state.status.substeps))
        speeds.append(float(np.abs(simulation.velocities).max()))
    return np.array(substeps), np.array(speeds)


def naive_turning(before, after):
    return sum(abs(v) > MIN_SPEED and v * w < -0.5 * v * v for v, w in zip(before, after, strict=True))


def test_coordinates_that_turn_are_counted():
    rng = np.random.default_rng(1)
    before, after = 5e-3 * rng.standard_normal((2, 999))
    assert count_oscillating(before, after, MIN_SPEED) == naive_turning(before, after) > 50
    assert count_oscillating(before, before, MIN_SPEED) == 0
    assert count_oscillating(np.full(9, 0.9 * MIN_SPEED), np.full(9, -1.0), MIN_SPEED) == 0


@pytest.mark.parametrize(("share", "usual"), [(1.01, 1), (1.06, 1), (1.03, 2), (1.03, 3)])
def test_a_step_beyond_the_critical_one_is_halved_before_anything_is_lost(share, usual):
    simulation = soft(share, usual)
    substeps, speeds = after_a_push(simulation, 4 * MAX_HALVED_TICKS)
    count = simulation.state.count
    assert 0 < count.oscillations < 8
    assert count.faults == 0
    assert set(substeps) == {usual, 2 * usual}
    assert np.mean(substeps == usual) < 0.1
    assert speeds.max() < 1.0


def test_a_stable_step_is_kept():
    simulation = soft(0.7)
    substeps, _ = after_a_push(simulation, 300)
    assert np.all(substeps[100:] == 1)
    assert simulation.state.count.faults == 0


def turn(simulation, turning, speed):
    """What a look finds after so many coordinates have turned around."""
    state, scratch = simulation.state, simulation.scratch
    scratch.velocity_before.ravel()[:turning] = speed
    state.velocity.ravel()[:turning] = -speed
    end_oscillation_check(handle(state), handle(scratch))


@pytest.mark.parametrize(
    ("turning", "speeds", "halved"),
    [(MIN_COORDINATES - 1, 2.0, 0), (MIN_COORDINATES, 2.0, HALVED_TICKS), (MIN_COORDINATES, 1.1, 0)],
)
def test_nodes_that_turn_count_when_they_are_many_and_get_faster(turning, speeds, halved):
    simulation = Simulation(ORGAN)
    for speed in (0.1, 0.1 * speeds):
        turn(simulation, turning, speed)
    assert simulation.state.status.oscillating == halved
    assert simulation.state.count.oscillations == (halved > 0)


@pytest.mark.extended
def test_what_is_found_again_soon_is_halved_longer_and_after_a_while_as_at_first():
    simulation = Simulation(ORGAN)
    state, found = simulation.state, []
    for wait in (0, 0, 0, 0, MAX_HALVED_TICKS):
        for _ in range(wait + int(state.status.oscillating)):
            is_oscillation_checked(handle(simulation.model), handle(state), 1)
        for speed in (0.1, 0.2):
            turn(simulation, MIN_COORDINATES, speed)
        found.append(int(state.status.oscillating))
    assert found == [
        HALVED_TICKS,
        HALVED_TICKS * HALVED_GROWTH,
        HALVED_TICKS * HALVED_GROWTH**2,
        MAX_HALVED_TICKS,
        HALVED_TICKS,
    ]


def test_where_a_step_was_found_too_long_the_next_find_needs_no_speed():
    simulation = Simulation(ORGAN)
    count, slow = simulation.state.count, np.array([10.0, 20.0]) * MIN_SPEED_AGAIN
    assert slow.max() < 0.5 * MIN_SPEED
    for speeds, found in ((slow, 0), ([0.1, 0.2], 1), (slow, 2)):
        for speed in speeds:
            turn(simulation, MIN_COORDINATES, speed)
        assert count.oscillations == found


@pytest.mark.parametrize("newton", [0.1, 0.3, 0.5])
def test_a_load_that_falls_on_a_patch_is_none(newton):
    simulation = Simulation(ORGAN, substeps=2)
    assert simulation.critical_step > 5e-4
    patch = np.argsort(-ORGAN.surface_positions[:, 2])[:7]
    for _ in range(600):
        simulation.apply_force(patch, np.tile([0.0, 0.0, -newton / 7.0], (7, 1)))
        simulation.step()
    assert simulation.state.count.oscillations == 0
    assert simulation.state.status.substeps == 2


def test_light_nodes_of_a_cut_oscillate_less_in_shorter_steps_or_with_larger_masses():
    """With two steps they became ever faster beside a blade, until the guard stopped the organ."""
    found, scaled, scene = {}, {}, Scene(slab(), [])
    scene.cut(0, *INCISION)
    for name, simulation in (("whole", Simulation(slab())), ("cut", scene.simulation)):
        model, state = simulation.model, simulation.state
        for stiff, oscillating in ((0, 0), (0, 1), (1, 0), (1, 1)):
            model.tissue.stiff[0], state.status.oscillating = stiff, oscillating
            found[name, stiff, oscillating] = substep_factor(handle(model), handle(state), True)
            scaled[name, stiff, oscillating] = is_mass_scaled(handle(model), handle(state))
    assert [found["whole", stiff, oscillating] for stiff in (0, 1) for oscillating in (0, 1)] == [1, 2, 2, 2]
    assert [found["cut", stiff, oscillating] for stiff in (0, 1) for oscillating in (0, 1)] == [1, 2, 2, 2]
    assert [each for each, is_scaled in scaled.items() if is_scaled] == [("cut", 1, 1)]


def test_a_blow_to_one_node_is_none():
    simulation = soft(0.8)
    top = int(np.argmax(ORGAN.surface_positions[:, 2]))
    for _ in range(300):
        simulation.apply_force(top, [0.0, 0.0, -0.01])
        simulation.step()
    assert simulation.state.count.oscillations == 0
    assert simulation.state.status.substeps == 1
