"""Tissue that relaxes: the standard linear solid in closed form, energy, sleep, and repetition bit for bit."""

from dataclasses import replace

import numpy as np
import pytest

from helpers.bars import bar
from helpers.scenes import ball, changed
from tissue_sim.errors import UserError
from tissue_sim.handles import handle
from tissue_sim.model.data.state import fields_of, make_state
from tissue_sim.model.elasticity.assembly import assemble
from tissue_sim.model.simulation import Simulation
from tissue_sim.model.stepping.relaxation import relax
from tissue_sim.organ.cell_mesh import with_cells

FRACTION, TIME = 0.4, 0.2
GROWTH = FRACTION / (1.0 - FRACTION)
STEP = 1e-3  # s


def relaxing(organ, fraction=FRACTION, time=TIME):
    return replace(organ, relaxation_fraction=fraction, relaxation_time=time)


BAR = bar(4, 0.01)
BALL = with_cells(ball(1))


# the recurrence --------------------------------------------------------------------------------
def answers(elastic, step=STEP):
    """Forces (t, n) N along x of tissue that moves with its elastic forces, which are these."""
    model, state = assemble(relaxing(BAR)), make_state(len(BAR.mass), 0, relaxes=True)
    held, memory, found = handle(model), handle(state), []
    slope = np.diff(elastic, axis=0, prepend=elastic[:1]) / step  # as a step of the integrator moves nodes
    for force, speed in zip(elastic, slope, strict=True):
        whole = np.zeros_like(model.rest)
        whole[:, 0] = force
        state.velocity[:, 0] = -speed / 100.0  # as springs of 100 N/m: what they receive is never negative
        relax(held, memory, whole, step)
        found.append(whole[:, 0].copy())
    return np.array(found)


def test_a_held_strain_relaxes_as_the_standard_linear_solid():
    time = STEP * np.arange(1500)
    elastic = np.repeat(np.minimum(time / 0.01, 1.0)[:, None], len(BAR.mass), axis=1)  # a ramp of 10 ms
    found = answers(elastic)[:, 0]
    held = time > 0.0105
    ramp = TIME / 0.01 * (np.exp(0.01 / TIME) - 1.0)
    np.testing.assert_allclose(found[held], 1.0 + GROWTH * ramp * np.exp(-time[held] / TIME), rtol=1e-4)
    assert found.max() == pytest.approx(1.0 / (1.0 - FRACTION), rel=0.03)


@pytest.mark.parametrize("frequency", [0.2, 1.0, 5.0])
def test_a_sinusoid_has_the_amplitude_and_phase_of_the_standard_linear_solid(frequency):
    rate = 2.0 * np.pi * frequency
    time = STEP * np.arange(round((10.0 * TIME + 5.0 / frequency) / STEP))
    elastic = np.repeat(np.sin(rate * time)[:, None], len(BAR.mass), axis=1)
    found = answers(elastic)[:, 5]
    last = time > time[-1] - 1.0 / frequency
    basis = np.stack([np.sin(rate * time[last]), np.cos(rate * time[last])], axis=1)
    real, imaginary = np.linalg.lstsq(basis, found[last], rcond=None)[0]
    wanted = 1.0 + GROWTH * 1j * rate * TIME / (1.0 + 1j * rate * TIME)
    assert abs(real + 1j * imaginary) == pytest.approx(abs(wanted), rel=5e-4)
    assert np.angle(real + 1j * imaginary) == pytest.approx(np.angle(wanted), abs=1e-3)


# in the tick -----------------------------------------------------------------------------------
def ends(organ):
    return np.flatnonzero(organ.surface_positions[:, 0] > organ.surface_positions[:, 0].max() - 1e-9)


def pull_of(simulation, nodes):
    return float(simulation.reactions()[nodes, 0].sum())


def test_a_bar_that_is_stretched_and_held_relaxes_to_its_elastic_force():
    organ = relaxing(BAR)
    simulation, elastic = Simulation(organ), Simulation(BAR)
    nodes = ends(organ)
    goal = organ.rest_positions[nodes] * [1.1, 1.0, 1.0]
    for one in (simulation, elastic):
        one.prescribe(nodes, goal, 20)
        one.step(400)
    at = [simulation.time]
    ramp = TIME / 0.02 * (np.exp(0.02 / TIME) - 1.0)
    found = [pull_of(simulation, nodes)]
    for _ in range(4):
        simulation.step(100)
        at.append(simulation.time)
        found.append(pull_of(simulation, nodes))
    elastic.step(400)
    left = pull_of(elastic, nodes)
    wanted = left * (1.0 + GROWTH * ramp * np.exp(-np.array(at) / TIME))
    np.testing.assert_allclose(found, wanted, rtol=2e-3)
    assert found[0] > 1.05 * left


def test_a_bar_that_swings_lags_by_the_phase_of_the_standard_linear_solid():
    simulation, nodes, rate = Simulation(relaxing(BAR)), ends(BAR), 2.0 * np.pi
    rest = BAR.rest_positions[nodes]
    pulls, times = [], []
    for tick in range(3000):
        goal = rest * [1.0 + 0.01 * np.sin(rate * (tick + 1) * STEP), 1.0, 1.0]
        simulation.prescribe(nodes, goal, 1)
        simulation.step()
        if tick >= 2000:
            times.append(simulation.time)
            pulls.append(pull_of(simulation, nodes))
    basis = np.stack([np.sin(rate * np.array(times)), np.cos(rate * np.array(times)), np.ones(1000)], axis=1)
    real, imaginary, _ = np.linalg.lstsq(basis, np.array(pulls), rcond=None)[0]
    wanted = 1.0 + GROWTH * 1j * rate * TIME / (1.0 + 1j * rate * TIME)
    assert np.angle(real + 1j * imaginary) == pytest.approx(np.angle(wanted), abs=0.02)


def test_the_first_answer_is_stiffer_and_needs_shorter_steps():
    assert Simulation(relaxing(BAR)).frequency == pytest.approx(
        Simulation(BAR).frequency / np.sqrt(1.0 - FRACTION), rel=1e-9
    )


def test_energy_is_never_created():
    """A ball that nothing holds or damps, thrown about: kinetic, elastic and unrelaxed energy together only fall."""
    free = changed(with_cells(ball(1, held=False)), damping=0.0)
    simulation = Simulation(relaxing(free), substeps=8)
    draw = np.random.default_rng(4)
    turning = np.cross([0.0, 0.0, 12.0], simulation.model.rest)
    simulation.velocities[:] = turning + 0.2 * draw.standard_normal(turning.shape)
    simulation.positions[:] *= [1.15, 1.0, 0.9]
    simulation.state.status.asleep = False
    energies = []
    for _ in range(1500):
        simulation.step()
        energies.append(simulation.energy.total)
        assert simulation.state.relaxing[0].energy >= 0.0
    start = energies[0]
    assert max(np.diff(energies)) < 0.02 * start  # symplectic steps swing about the energy
    assert max(energies[100:]) < 1.01 * start
    assert energies[-1] < 0.9 * start
    assert np.abs(simulation.state.unrelaxed.sum(axis=0)).max() < 1e-9 * np.abs(simulation.state.unrelaxed).sum()


@pytest.mark.parametrize("stretch", [(1.3, 0.9, 0.9), (0.8, 1.1, 1.1)])
def test_turning_stressed_tissue_to_and_fro_yields_no_work(stretch):
    """The bar is deformed, held until it has relaxed, then turned as a whole, again and again.

    Unlimited, the forces of the compressed bar give back sixteen times its elastic energy.
    """
    organ = replace(relaxing(BAR, 0.8, 0.1), fixed=np.zeros(0, dtype=np.int32))
    simulation = Simulation(organ)
    every = np.arange(organ.n_nodes)
    stretched = (organ.rest_positions - organ.rest_positions.mean(axis=0)) * stretch
    simulation.prescribe(every, stretched, 50)
    simulation.step(600)
    work, least = 0.0, 0.0
    for tick in range(800):
        angle = 0.8 * np.sin(2.0 * np.pi * (tick + 1) * STEP * 5.0)
        turn = np.array([[np.cos(angle), -np.sin(angle), 0.0], [np.sin(angle), np.cos(angle), 0.0], [0.0, 0.0, 1.0]])
        before, place = -simulation.state.unrelaxed.copy(), simulation.positions.copy()
        simulation.prescribe(every, stretched @ turn.T, 1)
        simulation.step()
        # What the unrelaxed forces take from what turns the bar; the elastic ones give back what they take.
        work += float(np.vdot(0.5 * (before - simulation.state.unrelaxed), simulation.positions - place))
        least = min(least, work)
    assert simulation.state.relaxing[0].energy >= 0.0
    assert least > -1e-3 * simulation.energy.elastic


def test_tissue_settles_where_elastic_tissue_does_and_falls_asleep():
    force = np.zeros((BALL.n_surface, 3))
    force[np.argsort(-BALL.surface_positions[:, 2])[:5], 2] = -0.05
    wanted, _ = Simulation(BALL).settle(force, 1e-5)
    simulation = Simulation(relaxing(BALL, 0.5, 10.0))
    found, settled = simulation.settle(force, 1e-5)
    assert settled
    assert np.abs(found - wanted).max() < 1e-4 * np.abs(wanted).max()
    simulation = Simulation(relaxing(BALL))
    for _ in range(200):
        simulation.apply_force(np.arange(BALL.n_surface), force)
        simulation.step()
    simulation.step(6000)
    assert simulation.asleep
    assert simulation.state.count.snaps == 0
    assert not simulation.state.unrelaxed.any()
    assert simulation.energy.total < 1e-15


# state -----------------------------------------------------------------------------------------
def pressed(simulation, ticks):
    force = np.zeros((BALL.n_surface, 3))
    force[np.argsort(-BALL.surface_positions[:, 2])[:5], 2] = -0.1
    for _ in range(ticks):
        simulation.apply_force(np.arange(BALL.n_surface), force)
        simulation.step()


def test_a_state_that_is_continued_repeats_bit_for_bit_and_a_reset_forgets():
    one, other = Simulation(relaxing(BALL)), Simulation(relaxing(BALL))
    pressed(one, 50)
    assert one.state.unrelaxed.any()
    kept = {name: value.copy() for name, value in fields_of(one.state).items()}
    other.restore(kept)
    for simulation in (one, other):
        pressed(simulation, 50)
    np.testing.assert_array_equal(one.state.words, other.state.words)
    one.reset()
    assert not one.state.unrelaxed.any()
    fresh = Simulation(relaxing(BALL))
    for simulation in (one, fresh):
        pressed(simulation, 30)
    np.testing.assert_array_equal(one.positions, fresh.positions)


def test_states_from_before_relaxation_fit_elastic_tissue_only():
    elastic = Simulation(BALL)
    names = ("relaxing", "unrelaxed", "last_elastic")
    old = {name: value.copy() for name, value in fields_of(elastic.state).items() if name not in names}
    elastic.restore(old)
    with pytest.raises(UserError, match="different 'relaxing'"):
        Simulation(relaxing(BALL)).restore(old)
    assert elastic.state.unrelaxed.shape == (0, 3)
