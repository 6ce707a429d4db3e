"""Cells that are squeezed no further: slopes against differences, and a cell that a fast node would turn inside out."""

import numpy as np
import pytest

from helpers.scenes import ball
from tissue_sim.jit import handle
from tissue_sim.model.assembly import assemble
from tissue_sim.model.cell_law import STIFF
from tissue_sim.model.cells import swelling
from tissue_sim.model.fans import cell_forces
from tissue_sim.model.simulation import Simulation
from tissue_sim.model.squeezed import LEAST, NEARLY, SQUEEZED_PASSES, find_squeezed, hold_squeezed, shape_cell
from tissue_sim.organ.cell_mesh import with_cells

ORGAN = with_cells(ball(2))
MODEL = assemble(ORGAN, "cells")
STEP = 2.5e-4  # s


def pressed(share, speed):
    """A simulation of which one node's cells are squeezed to a share, and squeezed on at a speed in m/s."""
    simulation = Simulation(ORGAN, model="cells")
    x, rest = simulation.positions, simulation.model.rest
    node = simulation.model.moving[0]
    cell = simulation.model.cells[np.any(simulation.model.cells == node, axis=1)][0]
    a, b, c = rest[cell[cell != node]]
    across = np.cross(b - a, c - a)
    across /= np.linalg.norm(across)
    height = float((rest[node] - a) @ across)
    x[node] = rest[node] - (1.0 - share) * height * across
    simulation.state.velocity[node] = -np.sign(height) * speed * across
    state, scratch, model = handle(simulation.state), handle(simulation.scratch), handle(simulation.model)
    cell_forces(x, handle(simulation.model.tissue), np.zeros_like(rest))
    before = swelling(simulation.model, x)
    x[node] += STEP * simulation.state.velocity[node]
    mobility = simulation.model.inverse_mass.copy()
    found = find_squeezed(model, state, mobility, scratch, STEP)
    return simulation, before, lambda: hold_squeezed(state, mobility, scratch, found, STEP), found


def test_the_volume_and_its_slopes_are_those_of_differences():
    x = MODEL.rest + 0.002 * np.random.default_rng(0).standard_normal(MODEL.rest.shape)
    nodes = MODEL.cells[7][[1, 0, 2, 3]].astype(np.int64)
    inverse = 1.0 / (6.0 * MODEL.cell_volume[7])
    slope, other = np.zeros((4, 3)), np.zeros((4, 3))
    assert shape_cell(x, nodes, inverse, slope) == pytest.approx(swelling(MODEL, x)[7], rel=1e-12)
    for corner, node in enumerate(nodes):
        for axis in range(3):
            ahead, behind = x.copy(), x.copy()
            ahead[node, axis] += 1e-7
            behind[node, axis] -= 1e-7
            rise = shape_cell(ahead, nodes, inverse, other) - shape_cell(behind, nodes, inverse, other)
            assert slope[corner, axis] == pytest.approx(rise / 2e-7, rel=1e-6, abs=1e-4)


def test_a_node_that_would_turn_cells_inside_out_is_stopped_and_momentum_is_kept():
    simulation, before, hold, found = pressed(0.25, 10.0)
    mass = np.zeros(len(MODEL.rest))
    mass[MODEL.moving] = 1.0 / MODEL.inverse_mass[MODEL.moving]
    momentum = mass @ simulation.state.velocity
    energy = mass @ np.sum(simulation.state.velocity**2, axis=1)
    assert before.min() > LEAST
    assert swelling(simulation.model, simulation.positions).min() < 0.0
    assert found > 0
    for _ in range(SQUEEZED_PASSES):
        hold()
    assert swelling(simulation.model, simulation.positions).min() > 0.5 * LEAST
    np.testing.assert_allclose(mass @ simulation.state.velocity, momentum, rtol=1e-9, atol=1e-12)
    assert mass @ np.sum(simulation.state.velocity**2, axis=1) < energy


def test_cells_that_nothing_squeezes_are_not_touched():
    simulation, _, hold, found = pressed(0.9, 0.0)
    x = simulation.positions.copy()
    assert found == 0
    assert hold()
    np.testing.assert_array_equal(simulation.positions, x)


def test_a_block_is_looked_at_before_its_cells_are_held():
    assert LEAST + NEARLY < STIFF
