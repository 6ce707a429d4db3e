"""Cells against a naive twin, the gradient of their energy, and closed forms."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from helpers.naive import naive_cells
from helpers.scenes import RADIUS, ball, uneven
from tissue_sim.model.data.blocks import BLOCK
from tissue_sim.model.elasticity.assembly import assemble
from tissue_sim.model.elasticity.cell_groups import cell_forces
from tissue_sim.model.elasticity.cell_law import COMPRESSED, STEEPEST, STIFF
from tissue_sim.model.elasticity.cells import (
    PENALTY,
    cell_energy,
    cell_forces_among,
    cell_slopes,
    cells_of,
    slots_of,
    subtract_linear_cells,
    tissue_of,
)
from tissue_sim.model.elasticity.cells import swelling as told
from tissue_sim.model.elasticity.frequency import largest_frequency
from tissue_sim.model.elasticity.modes import stiffness_matrix
from tissue_sim.model.simulation import Simulation
from tissue_sim.organ.cell_mesh import quality_of, tetrahedra


def filled(organ):
    """The organ with cells of its tissue that leave nothing out, flat ones neither."""
    x = organ.rest_positions
    cells = tetrahedra(x, organ.surface_positions, organ.surface_triangles)
    volume, quality = quality_of(x, cells)
    cells[volume < 0.0] = cells[volume < 0.0][:, [1, 0, 2, 3]]
    cells = cells[np.abs(quality) > 1e-6]
    mu, lam = np.outer(organ.lame_moduli, np.ones(len(cells)))
    return replace(organ, cell_nodes=cells, cell_mu=mu, cell_lambda=lam)


ORGAN = uneven(ball(2))
MODEL = assemble(ORGAN, "cells")
EDGE = 0.009  # m


def shaken(size, seed=1):
    return MODEL.rest + size * EDGE * np.random.default_rng(seed).standard_normal(MODEL.rest.shape)


def forces(x, model=MODEL):
    force = np.zeros_like(x)
    cell_forces(x, model.tissue, 1.0, force)
    return force


def energy(x, model=MODEL):
    return cell_energy(x, model.rest, model.tissue)


def swelling(x):
    """J of every cell."""
    cells, _, _ = cells_of(MODEL.tissue)

    def volume(points):
        return np.linalg.det(points[cells[:, 1:]] - points[cells[:, :1]])

    return volume(x) / volume(MODEL.rest)


def test_volumes_of_all_cells_are_told():
    x = MODEL.rest + 0.2 * 0.017 * np.random.default_rng(4).standard_normal(MODEL.rest.shape)
    np.testing.assert_allclose(np.sort(told(MODEL, x)), np.sort(swelling(x)), rtol=1e-9)


# the law ---------------------------------------------------------------------------------------
@pytest.mark.parametrize("size", [0.001, 0.1, 0.4])
def test_forces_are_those_of_the_naive_twin(size):
    x = shaken(size)
    wanted = naive_cells(x, MODEL)
    assert np.abs(forces(x) - wanted).max() < 1e-12 * np.abs(wanted).max()


@pytest.mark.parametrize(("size", "least"), [(0.05, STEEPEST), (0.15, 0.0), (0.6, -np.inf)])
def test_forces_are_the_slope_of_the_energy_squeezed_and_inside_out_too(size, least):
    x = shaken(size)
    assert least < swelling(x).min() < (1.0 if size < 0.1 else STEEPEST if size < 0.5 else 0.0)
    way = np.random.default_rng(2).standard_normal(x.shape)
    step = 1e-7 * EDGE
    slope = (energy(x + step * way) - energy(x - step * way)) / (2.0 * step)
    assert -np.vdot(forces(x), way) == pytest.approx(slope, rel=1e-6)


def test_neither_rest_nor_a_rigid_motion_costs_energy():
    size = np.abs(forces(shaken(0.1))).max()
    assert np.abs(forces(MODEL.rest)).max() < 1e-12 * size
    moved = Rotation.from_rotvec([0.4, -1.0, 0.7]).apply(MODEL.rest) + [0.1, 0.2, -0.3]
    assert np.abs(forces(moved)).max() < 1e-11 * size
    assert abs(energy(moved)) < 1e-12 * energy(shaken(0.1))


def test_forces_have_no_sum_and_no_torque():
    x = shaken(0.3)
    force = forces(x)
    assert np.abs(force.sum(axis=0)).max() < 1e-12 * np.abs(force).sum()
    assert np.abs(np.cross(x, force).sum(axis=0)).max() < 1e-12 * np.abs(force).sum() * RADIUS


@pytest.mark.parametrize("stretch", [0.7, 0.95, 1.3])
def test_an_even_stretch_has_the_energy_and_inner_balance_of_the_solid(stretch):
    organ = filled(ball(2))
    model = assemble(organ, "cells")
    squeeze = stretch**-0.3  # free at the sides, or nearly so
    x = model.rest * [squeeze, squeeze, stretch]
    mu, lam = organ.lame_moduli
    volume, square = stretch * squeeze**2, stretch**2 + 2.0 * squeeze**2
    density = 0.5 * mu * (square - 3.0 - 2.0 * np.log(volume))
    density += 0.25 * lam * (volume**2 - 1.0 - 2.0 * np.log(volume))
    assert energy(x, model) == pytest.approx(density * model.cell_volume.sum(), rel=1e-12)
    inner = slice(organ.n_surface, None)
    assert np.abs(forces(x, model)[inner]).max() < 1e-12 * np.abs(forces(x, model)).max()


def test_the_tangent_at_rest_is_that_of_linear_elasticity():
    tangent = stiffness_matrix(MODEL)
    way = np.random.default_rng(3).standard_normal(MODEL.rest.shape)
    step = 1e-6 * EDGE
    product = (forces(MODEL.rest - step * way) - forces(MODEL.rest + step * way)) / (2.0 * step)
    found = (tangent @ way.ravel()).reshape(way.shape)
    assert np.abs(found - product).max() < 1e-6 * np.abs(product).max()


def test_a_penalty_is_as_stiff_as_the_masses_allow():
    cells, _, penalty = cells_of(MODEL.tissue)
    frequency = largest_frequency(MODEL)
    step = 1e-6 * EDGE
    for cell in (0, len(cells) // 2, len(cells) - 1):
        nodes = cells[cell]
        slope = np.zeros_like(MODEL.rest)
        for node in nodes:
            for axis in range(3):
                ahead, behind = MODEL.rest.copy(), MODEL.rest.copy()
                ahead[node, axis] += step
                behind[node, axis] -= step
                slope[node, axis] = (swelling(ahead)[cell] - swelling(behind)[cell]) / (2.0 * step)
        give = np.sum(MODEL.inverse_mass[:, None] * slope**2)
        volume = np.linalg.det(MODEL.rest[nodes[1:]] - MODEL.rest[nodes[0]]) / 6.0
        assert volume * penalty[cell] * give == pytest.approx(PENALTY * frequency**2, rel=1e-6)
    assert COMPRESSED > STEEPEST


def test_blocks_repeat_bit_for_bit_and_fill_up_with_nothing():
    x = shaken(0.3)
    np.testing.assert_array_equal(forces(x), forces(x))
    cells, moduli, _ = cells_of(MODEL.tissue)
    odd = BLOCK + 3
    few = tissue_of(MODEL.rest, cells[:odd], *moduli[:, :odd])
    assert len(few.nodes) == 2
    force = np.zeros_like(x)
    cell_forces(x, few, 1.0, force)
    untouched = np.setdiff1d(np.arange(len(x)), cells[:odd])
    assert not force[untouched].any()
    wanted = naive_cells(x, MODEL._replace(tissue=few))
    assert np.abs(force - wanted).max() < 1e-12 * np.abs(wanted).max()


# in the tick -----------------------------------------------------------------------------------
def test_an_organ_of_cells_settles_where_the_forces_balance_and_falls_asleep():
    simulation = Simulation(ORGAN, model="cells")
    force = np.zeros((ORGAN.n_surface, 3))
    force[np.argsort(-ORGAN.surface_positions[:, 2])[:7], 2] = -0.1
    displacement, settled = simulation.settle(force, 1e-6)
    assert settled
    assert displacement[:, 2].min() < -1e-3
    left = forces(simulation.positions)
    left[: ORGAN.n_surface] += force
    assert np.linalg.norm(left[MODEL.moving]) <= 1e-6 * np.linalg.norm(force)
    assert simulation.energy.elastic == pytest.approx(energy(simulation.positions), rel=1e-12)
    for _ in range(3000):
        simulation.step()
    assert simulation.asleep
    np.testing.assert_array_equal(simulation.positions, MODEL.rest)


def test_energy_falls_after_a_release_and_no_cell_stays_inside_out():
    simulation = Simulation(ORGAN, model="cells")
    simulation.positions[MODEL.moving] *= 0.95
    simulation.state.status.asleep = False
    energies = [simulation.energy.total]
    for _ in range(400):
        simulation.step()
        energies.append(simulation.energy.total)
    # Symplectic steps swing about the energy by the step's length, and gain none.
    assert max(energies[1:]) < 1.1 * energies[0]
    assert max(energies[200:]) < 1e-3 * energies[0]
    assert simulation.state.count.faults == 0
    assert swelling(simulation.positions).min() > 0.9


@pytest.mark.parametrize(("share", "factor"), [(0.95, 1), (0.6, 2)])
def test_the_tick_that_finds_squeezed_cells_takes_more_substeps(share, factor):
    simulation = Simulation(ORGAN, model="cells", substeps=3)
    simulation.positions[MODEL.moving] *= share
    simulation.state.status.asleep = False
    stiff = np.count_nonzero(swelling(simulation.positions) < STIFF)
    assert (stiff > 0) == (factor > 1)
    simulation.step()
    assert simulation.state.status.substeps == 3 * factor
    assert simulation.state.count.faults == 0
    forces(MODEL.rest * share)
    assert (MODEL.tissue.stiff[0] > 0) == (factor > 1)


# some of them ----------------------------------------------------------------------------------
def some_of(model, step=3):
    """The same tissue's every third block, the nodes of it, and which of the cells these are."""
    nodes, constants = model.tissue.nodes[::step].copy(), model.tissue.constants[::step].copy()
    slots = slots_of(model.tissue)
    chosen = slots[(slots // BLOCK) % step == 0]
    return nodes, constants, np.unique(nodes), model.tissue.nodes.reshape(-1, 4)[chosen]


def test_forces_of_some_cells_are_those_of_an_organ_that_has_no_others():
    nodes, constants, among, cells = some_of(MODEL)
    slots = {tuple(cell) for cell in cells.tolist()}
    kept = np.array([tuple(cell) in slots for cell in ORGAN.cell_nodes.tolist()])
    fewer = replace(
        ORGAN, cell_nodes=ORGAN.cell_nodes[kept], cell_mu=ORGAN.cell_mu[kept], cell_lambda=ORGAN.cell_lambda[kept]
    )
    assert 0 < kept.sum() < 0.5 * len(kept)
    x, found = shaken(0.2), np.zeros_like(MODEL.rest)
    tissue = tissue_of(MODEL.rest, fewer.cell_nodes, fewer.cell_mu, fewer.cell_lambda)
    # The penalty is each organ's own: none here.
    constants[:, 9 * BLOCK :] = 0.0
    cell_forces_among(x, among, nodes, constants, MODEL.tissue, np.zeros(9 * BLOCK), found)
    wanted = np.zeros_like(x)
    cell_forces(x, tissue, 1.0, wanted)
    assert np.abs(found - wanted).max() < 1e-12 * np.abs(wanted).max()
    assert not found[np.setdiff1d(np.arange(len(x)), among)].any()


def test_linear_forces_that_are_subtracted_are_those_of_the_tangent_at_rest():
    x = shaken(0.3)
    slopes, found = cell_slopes(MODEL.tissue, MODEL.rest), np.zeros_like(x)
    every = np.arange(len(x), dtype=np.int32)
    subtract_linear_cells(x, every, MODEL.tissue.nodes, slopes, MODEL.tissue, np.zeros(9 * BLOCK), found)
    wanted = stiffness_matrix(MODEL) @ (x - MODEL.rest).ravel()
    assert np.abs(found.ravel() - wanted).max() < 1e-11 * np.abs(wanted).max()
