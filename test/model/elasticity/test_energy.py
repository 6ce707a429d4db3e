"""Energy of a state as users read it: nothing at rest, kept where nothing damps, work in equals energy gained."""

import numpy as np
import pytest

from helpers.pressing import poke, top_node
from helpers.scenes import ball, changed, free_ball, kidney
from tissue_sim.model.elasticity.forces import elastic_forces
from tissue_sim.model.simulation import Simulation


def spinning(organ, **options):
    """An organ awake, its nodes at random speeds of 50 mm/s, its energies over 400 ticks, J."""
    simulation = Simulation(organ, **options)
    simulation.state.status.asleep = False
    nodes = simulation.model.moving
    simulation.velocities[nodes] = 0.05 * np.random.default_rng(0).standard_normal((len(nodes), 3))
    energies = [simulation.energy.total]
    for _ in range(400):
        simulation.step()
        energies.append(simulation.energy.total)
    return np.array(energies)


@pytest.mark.parametrize("variant", ["surface", "volume", "hybrid"])
@pytest.mark.parametrize("organ", [ball(), ball(3)], ids=["ball", "fine ball"])
def test_rest_has_no_energy(organ, variant):
    kinetic, elastic = Simulation(organ, model=variant).energy
    assert kinetic == 0.0
    assert 0.0 <= elastic < 1e-25


def test_parts_are_those_of_a_moving_node_and_of_a_scaled_tissue():
    simulation = Simulation(ball())
    node = top_node(ball())
    simulation.velocities[node] = [0.3, 0.0, -0.4]
    assert simulation.energy.kinetic == pytest.approx(0.5 * 0.25 / simulation.model.inverse_mass[node])
    assert simulation.energy.elastic < 1e-25
    simulation.positions[node, 2] -= 0.001
    elastic = simulation.energy.elastic
    assert elastic > 1e-8
    simulation.settings.stiffness_scale = 3.0
    assert simulation.energy.elastic == pytest.approx(3.0 * elastic)
    assert simulation.energy.total == simulation.energy.kinetic + simulation.energy.elastic


@pytest.mark.parametrize("substeps", [8, 16])
def test_work_done_by_a_force_is_the_energy_gained(substeps):
    """Nothing is damped; what is left goes with the substep."""
    simulation = Simulation(changed(ball(), damping=0.0), substeps=substeps)
    node, force, work = top_node(ball()), np.array([0.02, 0.01, -0.08]), 0.0
    for _ in range(40):
        before = simulation.positions[node].copy()
        poke(simulation, 1, force)
        work += force @ (simulation.positions[node] - before)
    assert work > 1e-5
    assert simulation.energy.total == pytest.approx(work, rel=0.16 / substeps)


def test_free_organ_that_nothing_damps_keeps_its_energy():
    energies = spinning(free_ball())
    assert np.mean(energies[-100:]) == pytest.approx(np.mean(energies[:100]), rel=2e-3)
    assert np.ptp(energies) < 0.1 * energies[0]


def test_explicit_euler_gains_energy_where_nothing_damps():
    """As the closed form of a single mass has it: (1 + (wh)^2) a step. The tests beside this one can fail."""
    energies = spinning(free_ball(), integrator="explicit", substeps=20)
    assert energies[60:140].min() > 1.5 * energies[0]


def test_energy_decays_where_it_is_damped():
    energies = spinning(ball(held=False))
    assert energies.max() <= energies[0] * (1.0 + 1e-9)
    # Over twenty ticks none of the organ's swinging between speed and stretch is left to see.
    seen = energies[:-20] > 1e-9 * energies[0]
    assert seen.sum() > 60
    assert np.all(energies[20:][seen] < energies[:-20][seen])
    assert energies[-1] < 0.7 * energies[0]


def kept_energy(simulation):
    """What symplectic Euler keeps where nothing damps, J: the energy, and h/2 v.f that swings between its kinds."""
    model, force = simulation.model, np.zeros_like(simulation.positions)
    elastic_forces(model, simulation.positions, 1.0, force)
    step = 1e-3 / simulation.state.status.substeps
    nodes = model.moving
    return simulation.energy.total + 0.5 * step * np.vdot(simulation.velocities[nodes], force[nodes])


@pytest.mark.parametrize("organ", [ball(2), pytest.param(kidney(), marks=pytest.mark.extended)], ids=["ball", "kidney"])
@pytest.mark.parametrize("force", [0.02, 0.3])
def test_energy_never_grows_after_a_poke(organ, force):
    simulation = Simulation(organ)
    poke(simulation, 60, [0.2 * force, 0.0, -force])
    energies = []
    for _ in range(400):
        simulation.step()
        energies.append(kept_energy(simulation))
    assert simulation.state.status.substeps == simulation.settings.substeps
    assert energies[0] > 1e-7
    assert np.diff(energies).max() <= 1e-9 * energies[0]
    assert energies[-1] < 1e-3 * energies[0]


@pytest.mark.parametrize("organ", [ball(2), pytest.param(kidney(), marks=pytest.mark.extended)], ids=["ball", "kidney"])
def test_node_pulled_through_the_organ_gives_back_no_more_than_was_put_in(organ):
    """So crumpled, the energy that a step keeps is known to some percent only; on the way back no springs act."""
    simulation = Simulation(organ)
    poke(simulation, 60, [0.6, 0.0, -3.0])
    first = least = simulation.energy.total
    assert first > 0.01
    assert simulation.state.count.faults == 0
    ticks = 0
    for _ in range(700):
        simulation.step()
        energy = simulation.energy.total
        assert energy < first
        if not simulation.state.status.snapped and not simulation.state.count.snaps:
            assert energy <= 1.1 * least + 1e-9 * first
            least, ticks = min(least, energy), ticks + 1
    assert ticks > 50
    assert energy < 1e-3 * first
