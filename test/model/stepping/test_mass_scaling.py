"""Nodes of compressed cells are heavier while nodes oscillate, and as before afterwards."""

import numpy as np
import pytest

from helpers.scenes import ball, filled
from helpers.slabs import slab
from helpers.states import snapshot
from tissue_sim.contact.scene import Scene
from tissue_sim.contact.tools import Tool
from tissue_sim.model.elasticity.cell_law import COMPRESSED
from tissue_sim.model.simulation import Simulation
from tissue_sim.model.stepping.mass_scaling import LARGEST, RANGE
from tissue_sim.organ.cell_mesh import with_cells

OSCILLATING = 5  # ticks


def ratios_of(simulation):
    """Return the volume ratio of every cell."""
    model = simulation.model
    edges = [at[model.cells[:, 1:]] - at[model.cells[:, :1]] for at in (simulation.state.position, model.rest)]
    return np.linalg.det(edges[0]) / np.linalg.det(edges[1])


def press(simulation, least):
    """Move a node inward until the least volume ratio has a value, to which it falls linearly; return all ratios."""
    model, position = simulation.model, simulation.state.position
    node = int(np.argmax(np.where(model.inverse_mass > 0.0, model.rest[:, 2], -np.inf)))
    position[node, 2] -= 1e-3
    position[node, 2] -= 1e-3 * ((1.0 - least) / (1.0 - ratios_of(simulation).min()) - 1.0)
    return ratios_of(simulation)


def naive_factors(simulation, ratios):
    """Return the factor on each node's mass by a loop over all cells."""
    factor = np.ones(len(simulation.model.rest))
    for cell, ratio in zip(simulation.model.cells, ratios, strict=True):
        for node in cell:
            factor[node] = max(factor[node], 1.0 + (LARGEST - 1.0) * np.clip((COMPRESSED - ratio) / RANGE, 0.0, 1.0))
    return factor


def with_a_blade():
    """A simulation of an organ that a blade may cut."""
    return Scene(slab(), [Tool("knife", shape="blade", radius=1e-3, length=0.01, height=0.01)]).simulation


@pytest.mark.parametrize("least", [0.45, 0.3, 0.1])
def test_factors_are_those_of_the_twin_and_divide_mobilities(least):
    simulation, plain = with_a_blade(), with_a_blade()
    ratios = press(simulation, least)
    press(plain, least)
    simulation.state.status.oscillating = OSCILLATING
    for one in (simulation, plain):
        one.apply_force(0, [0.0, 0.0, 1e-9])  # awake
        one.step()
    assert plain.scratch.mass_factor.max() == 1.0
    assert ratios.min() == pytest.approx(least)
    factor = simulation.scratch.mass_factor
    np.testing.assert_allclose(factor, naive_factors(simulation, ratios), rtol=1e-9)
    moving = simulation.model.moving
    assert simulation.state.status.substeps == plain.state.status.substeps
    step = simulation.settings.tick_time / simulation.state.status.substeps
    damping = simulation.settings.damping_scale * simulation.model.damping[moving]
    mass = factor[moving] / simulation.model.inverse_mass[moving]
    np.testing.assert_allclose(simulation.scratch.mobility[moving], 1.0 / (mass + step * damping), rtol=1e-12)


def test_masses_are_the_same_bits_again_when_nodes_no_longer_oscillate():
    simulation, plain = with_a_blade(), with_a_blade()
    press(simulation, 0.3)
    simulation.state.status.oscillating = 1
    for one in (simulation, plain):
        one.apply_force(0, [0.0, 0.0, 1e-9])
        one.step()
    assert (simulation.scratch.push != plain.scratch.push).any()
    simulation.reset()
    for one in (simulation, plain):
        one.apply_force(0, [0.0, 0.0, 1e-9])
        one.step()
    for name in ("mobility", "push", "shrink"):
        np.testing.assert_array_equal(getattr(simulation.scratch, name), getattr(plain.scratch, name))


def test_a_restored_state_leaves_no_larger_masses_behind():
    simulation, plain = with_a_blade(), with_a_blade()
    begin = snapshot(simulation)
    press(simulation, 0.3)
    simulation.state.status.oscillating = OSCILLATING
    simulation.apply_force(0, [0.0, 0.0, 1e-9])
    simulation.step()
    assert simulation.scratch.mass_factor.max() > 1.0
    simulation.restore(begin)
    for one in (simulation, plain):
        one.apply_force(0, [0.0, 0.0, 1e-9])
        one.step()
    np.testing.assert_array_equal(simulation.scratch.push, plain.scratch.push)


def test_an_organ_that_nothing_cuts_takes_shorter_steps_alone():
    simulation = Simulation(with_cells(filled(ball(2), 20), (1.0, 1.0)))
    assert press(simulation, 0.3).min() < COMPRESSED
    simulation.state.status.oscillating = OSCILLATING
    simulation.apply_force(0, [0.0, 0.0, 1e-9])
    simulation.step()
    assert simulation.scratch.mass_factor.max() == 1.0
