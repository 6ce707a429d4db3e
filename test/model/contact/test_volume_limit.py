"""Cells that are squeezed no further: slopes against differences, a NumPy twin, and a load that presses a cell flat."""

from dataclasses import replace

import numpy as np
import pytest

from helpers.scenes import ball
from tissue_sim.handles import handle
from tissue_sim.model.contact.volume_limit import (
    COMPRESSED_PASSES,
    MAX_PRESSURE,
    MIN_VOLUME_RATIO,
    NEARLY,
    RECOVERY_RATE,
    enforce_volume_limit,
    find_compressed_cells,
    slopes_of,
    volume_of,
)
from tissue_sim.model.elasticity.assembly import assemble
from tissue_sim.model.elasticity.cell_groups import cell_forces
from tissue_sim.model.elasticity.cell_law import STIFF
from tissue_sim.model.elasticity.cells import cells_of, swelling
from tissue_sim.model.simulation import Simulation
from tissue_sim.organ.cell_mesh import with_cells

ORGAN = with_cells(ball(2))
MODEL = assemble(ORGAN, "cells")
STEP = 2.5e-4  # s


class Pressed:
    """A simulation of which one node's cells are squeezed to a share, and squeezed on at a speed in m/s for a step."""

    def __init__(self, share, speed):
        self.simulation = Simulation(ORGAN, model="cells")
        self.model, self.scratch = self.simulation.model, self.simulation.scratch
        self.x, self.v = self.simulation.positions, self.simulation.velocities
        rest, node = self.model.rest, self.model.moving[0]
        cell = self.model.cells[np.any(self.model.cells == node, axis=1)][0]
        a, b, c = rest[cell[cell != node]]
        across = np.cross(b - a, c - a)
        across /= np.linalg.norm(across)
        height = float((rest[node] - a) @ across)
        self.x[node] = rest[node] - (1.0 - share) * height * across
        self.v[node] = -np.sign(height) * speed * across
        cell_forces(self.x, handle(self.model.tissue), 1.0, np.zeros_like(rest))
        self.before = swelling(self.model, self.x)
        self.x[node] += STEP * self.v[node]
        self.mobility = self.model.inverse_mass.copy()
        self.scratch.mobility[:] = self.mobility
        self._held = [handle(one) for one in (self.simulation.state, self.scratch)]
        self.found = find_compressed_cells(handle(self.model), self._held[0], self._held[1], STEP)

    def hold(self):
        """One pass."""
        return enforce_volume_limit(self._held[0], self._held[1], self.found, STEP)


def volume_and_slopes(x, nodes, volume):
    """Volume over that at rest, m^3, and its slopes (4, 3) 1/m, of a cell by the determinant's cofactors."""
    edges = (x[nodes[1:]] - x[nodes[0]]).T
    share = np.linalg.det(edges) / (6.0 * volume)
    slopes = share * np.linalg.inv(edges)
    return share, np.vstack([-slopes.sum(axis=0), slopes])


def naive_hold(pressed, passes):
    """Where positions, velocities and impulses are after so many passes over the cells in the kernel's order."""
    x, v, mobility = pressed.x.copy(), pressed.v.copy(), pressed.mobility
    cells, _, penalties = cells_of(pressed.model.tissue)
    number = {frozenset(cell): (k, penalty) for k, (cell, penalty) in enumerate(zip(cells, penalties, strict=True))}
    volumes = np.abs(np.linalg.det(MODEL.rest[cells[:, 1:]] - MODEL.rest[cells[:, :1]])) / 6.0
    todo = []
    for nodes in pressed.scratch.compressed[: pressed.found].node:
        cell, penalty = number[frozenset(nodes)]
        before, slope = volume_and_slopes(x - STEP * v, nodes, volumes[cell])
        give = STEP * np.sum(mobility[nodes, None] * slope**2)
        most = STEP * MAX_PRESSURE * penalty * volumes[cell]
        todo.append((nodes, volumes[cell], slope, give, min(MIN_VOLUME_RATIO, before + STEP * RECOVERY_RATE), most))
    impulse = np.zeros(len(todo))
    for _ in range(passes):
        for k, (nodes, volume, slope, give, wanted, most) in enumerate(todo):
            share, _ = volume_and_slopes(x, nodes, volume)
            last, impulse[k] = impulse[k], np.clip(impulse[k] + (wanted - share) / give, 0.0, most)
            change = (impulse[k] - last) * mobility[nodes, None] * slope
            v[nodes] += change
            x[nodes] += STEP * change
    return x, v, impulse


def test_the_volume_and_its_slopes_are_those_of_differences_where_the_cell_was():
    rng = np.random.default_rng(0)
    x = MODEL.rest + 0.002 * rng.standard_normal(MODEL.rest.shape)
    v = rng.standard_normal(MODEL.rest.shape)
    nodes = MODEL.cells[7][[1, 0, 2, 3]].astype(np.int64)
    inverse = 1.0 / (6.0 * MODEL.cell_volume[7])
    assert volume_of(x, nodes, inverse) == pytest.approx(swelling(MODEL, x)[7], rel=1e-12)
    slope, was = np.zeros((4, 3)), x - STEP * v
    assert slopes_of(x, v, STEP, nodes, inverse, slope) == pytest.approx(swelling(MODEL, was)[7], rel=1e-12)
    for corner, node in enumerate(nodes):
        for axis in range(3):
            ahead, behind = was.copy(), was.copy()
            ahead[node, axis] += 1e-7
            behind[node, axis] -= 1e-7
            rise = volume_of(ahead, nodes, inverse) - volume_of(behind, nodes, inverse)
            assert slope[corner, axis] == pytest.approx(rise / 2e-7, rel=1e-6, abs=1e-4)


@pytest.mark.parametrize(("share", "speed"), [(0.25, 10.0), (0.12, 2.0), (0.05, 0.0), (0.12, 40.0)])
def test_cells_are_found_and_held_as_the_twin_has_them(share, speed):
    pressed = Pressed(share, speed)
    now = swelling(pressed.model, pressed.x)
    listed = {frozenset(nodes) for nodes in pressed.scratch.compressed[: pressed.found].node}
    looked_at = (pressed.before < STIFF) & (now <= MIN_VOLUME_RATIO + NEARLY)
    assert listed >= {frozenset(cell) for cell in pressed.model.cells[looked_at]} != set()
    assert listed <= {frozenset(cell) for cell in pressed.model.cells[now <= MIN_VOLUME_RATIO + NEARLY]}
    x, v, impulse = naive_hold(pressed, COMPRESSED_PASSES)
    for _ in range(COMPRESSED_PASSES):
        pressed.hold()
    assert impulse.max() > 0.0
    np.testing.assert_allclose(pressed.scratch.compressed[: pressed.found].impulse, impulse, rtol=1e-9)
    np.testing.assert_allclose(pressed.x, x, atol=1e-12)
    np.testing.assert_allclose(pressed.v, v, atol=1e-9)


def test_a_node_that_would_turn_cells_inside_out_is_stopped_and_momentum_is_kept():
    pressed = Pressed(0.25, 10.0)
    mass = np.zeros(len(MODEL.rest))
    mass[MODEL.moving] = 1.0 / MODEL.inverse_mass[MODEL.moving]
    momentum = mass @ pressed.v
    energy = mass @ np.sum(pressed.v**2, axis=1)
    assert pressed.before.min() > MIN_VOLUME_RATIO
    assert swelling(MODEL, pressed.x).min() < 0.0
    assert pressed.found > 0
    for _ in range(COMPRESSED_PASSES):
        pressed.hold()
    assert swelling(MODEL, pressed.x).min() > 0.5 * MIN_VOLUME_RATIO
    np.testing.assert_allclose(mass @ pressed.v, momentum, rtol=1e-9, atol=1e-12)
    assert mass @ np.sum(pressed.v**2, axis=1) < energy


def test_cells_that_nothing_squeezes_are_not_touched():
    pressed = Pressed(0.9, 0.0)
    x = pressed.x.copy()
    assert pressed.found == 0
    assert pressed.hold()
    np.testing.assert_array_equal(pressed.x, x)


def test_a_load_that_presses_a_cell_flat_settles_with_what_holds_it():
    top = int(np.argmax(ORGAN.surface_positions[:, 2]))
    soft = int(np.flatnonzero(np.any(ORGAN.cell_nodes == top, axis=1))[1])
    share = np.ones(len(ORGAN.cell_nodes))
    share[soft] = 0.01
    organ = replace(ORGAN, cell_mu=share * ORGAN.cell_mu, cell_lambda=share * ORGAN.cell_lambda)
    simulation = Simulation(organ, model="cells")
    force = np.zeros((organ.n_surface, 3))
    force[top, 2] = -4.0
    _, settled = simulation.settle(force, 1e-4, 4.0, 0.3)
    assert settled
    assert swelling(simulation.model, simulation.positions).min() == pytest.approx(MIN_VOLUME_RATIO, abs=1e-6)
    assert simulation.scratch.compressed.impulse[: simulation.scratch.n_compressed[0]].max() > 0.0
    assert simulation.state.count.faults == 0


def test_a_block_is_looked_at_before_its_cells_are_held():
    assert MIN_VOLUME_RATIO + NEARLY < STIFF
