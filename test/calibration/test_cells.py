"""Cells in the fit: the model's own law, its slopes by finite differences, and a fit that finds moduli."""

from dataclasses import replace

import numpy as np
import pytest

from helpers.scenes import ball
from tissue_sim.calibration import calibrate as pipeline
from tissue_sim.calibration.calibrate import CELL_BOUNDS, with_moduli
from tissue_sim.calibration.cells import Cells
from tissue_sim.calibration.fit import LinearMisfit, fit
from tissue_sim.calibration.static import settle
from tissue_sim.model.assembly import assemble
from tissue_sim.model.blocks import BLOCK
from tissue_sim.model.cells import CONSTANTS, STEEPEST, cell_energy, cell_forces, strain_rows
from tissue_sim.model.modes import stiffness_matrix
from tissue_sim.model.simulation import Simulation
from tissue_sim.organ.cell_mesh import with_cells
from tissue_sim.organ.topology import assemble_like

ORGAN = with_cells(assemble_like(ball(2), interior_atoms=20))
MODEL = assemble(ORGAN, "cells")
CELLS = Cells(MODEL)
EVEN = np.concatenate([ORGAN.cell_mu, ORGAN.cell_lambda])
MODULI = EVEN * np.exp(0.5 * np.random.default_rng(0).normal(size=len(EVEN)))


def shaken(size, seed=1):
    x = MODEL.rest.copy()
    x[MODEL.moving] += size * np.random.default_rng(seed).standard_normal((len(MODEL.moving), 3))
    return x


def way(seed=2):
    found = np.zeros(MODEL.rest.size)
    found[CELLS.free] = np.random.default_rng(seed).standard_normal(len(CELLS.free))
    return found.reshape(MODEL.rest.shape)


def without_penalty(model):
    constants = model.tissue.constants.copy()
    constants[:, (CONSTANTS - 1) * BLOCK :] = 0.0
    return model._replace(tissue=model.tissue._replace(constants=constants))


def pushes(count, seed=0):
    """Smooth loads on the ball's upper half, N."""
    draw, x = np.random.default_rng(seed), ORGAN.surface_positions
    centre = x[draw.choice(np.flatnonzero(x[:, 2] > 0.0), count)]
    share = np.exp(-np.sum((x - centre[:, None]) ** 2, axis=2) / 0.01**2)
    return 0.02 * share[:, :, None] * draw.standard_normal((count, 1, 3))


@pytest.mark.parametrize("size", [1e-4, 2e-3])
def test_energy_and_gradient_are_those_of_the_model(size):
    model = without_penalty(assemble(with_moduli(ORGAN, MODULI), "cells"))
    x = shaken(size)
    if size > 1e-3:
        assert CELLS.least_volume(x) < STEEPEST
    force = np.zeros_like(x)
    cell_forces(x, model.tissue, np.zeros(9 * BLOCK), force)
    energy, gradient = CELLS.energy_and_gradient(x, MODULI)
    assert np.abs(gradient + force).max() < 1e-12 * np.abs(force).max()
    assert energy == pytest.approx(cell_energy(x, model.rest, model.tissue), rel=1e-11)


@pytest.mark.parametrize("size", [1e-4, 2e-3])
def test_tangent_and_sensitivity_are_slopes_of_the_gradient(size):
    x, direction, step = shaken(size), way(), 1e-9
    ahead, behind = (CELLS.energy_and_gradient(x + s * step * direction, MODULI)[1] for s in (1.0, -1.0))
    slope = ((ahead - behind) / (2.0 * step)).ravel()[CELLS.free]
    found = CELLS.tangent(x, MODULI) @ direction.ravel()[CELLS.free]
    assert np.abs(found - slope).max() < 1e-6 * np.abs(slope).max()
    change = 0.1 * MODULI * np.random.default_rng(3).standard_normal(len(MODULI))
    more, less = (CELLS.energy_and_gradient(x, MODULI + s * change)[1] for s in (1.0, -1.0))
    assert CELLS.sensitivity(x, direction) @ change == pytest.approx(np.vdot(more - less, direction) / 2.0, rel=1e-9)


def test_the_convex_tangent_is_positive_definite_where_the_other_is_not():
    x = shaken(2e-3)
    assert np.linalg.eigvalsh(CELLS.tangent(x, MODULI, convex=True).toarray()).min() > 0.0
    assert np.linalg.eigvalsh(CELLS.tangent(x, MODULI).toarray()).min() < 0.0


def test_at_rest_moduli_and_the_models_own_matrix_agree():
    model = assemble(with_moduli(ORGAN, MODULI), "cells")
    wanted = stiffness_matrix(model)[CELLS.free][:, CELLS.free].toarray()
    found = CELLS.rest_tangent(MODULI).toarray()
    assert np.abs(found - wanted).max() < 1e-12 * np.abs(wanted).max()
    rows, owner = strain_rows(CELLS.rest, CELLS.nodes)
    rows = rows[:, CELLS.free]
    by_rows = (rows.T @ rows.multiply(MODULI[owner][:, None])).toarray()
    assert np.abs(by_rows - wanted).max() < 1e-12 * np.abs(wanted).max()
    answer, adjoint = np.random.default_rng(2).standard_normal((2, len(CELLS.free), 5))
    work = np.bincount(owner, np.einsum("rc,rc->r", rows @ answer, rows @ adjoint))
    np.testing.assert_allclose(
        CELLS.rest_sensitivity(answer, adjoint), work, rtol=1e-9, atol=1e-12 * np.abs(work).max()
    )
    free = Cells(assemble(replace(ORGAN, fixed=ORGAN.fixed[:0]), "cells"))
    assert free.trace() @ MODULI == pytest.approx(free.rest_tangent(MODULI).trace(), rel=1e-12)


def test_newton_and_the_simulation_find_the_same_rest():
    organ = with_moduli(ORGAN, MODULI)
    force = pushes(1)[0]
    settled, factor = settle(CELLS, MODULI, force)
    assert settled.converged
    assert settled.stable
    assert factor is not None
    found, rested = Simulation(organ, model="cells").settle(force, 1e-7)
    assert rested
    wanted = settled.position[: organ.n_surface] - MODEL.rest[: organ.n_surface]
    assert np.abs(wanted).max() > 1e-4
    assert np.abs(found - wanted).max() < 1e-5 * np.abs(wanted).max()


def test_the_slope_of_the_misfit_and_a_fit_that_finds_what_made_the_answers():
    load = pushes(40)
    wanted = linear_answers(MODULI, load)
    misfit = LinearMisfit(CELLS, load, wanted)
    assert misfit.evaluate(MODULI).error.max() < 0.02
    start = misfit.evaluate(EVEN)
    change = 1e-5 * EVEN * np.random.default_rng(5).standard_normal(len(EVEN))
    rise = misfit.evaluate(EVEN + change).loss - misfit.evaluate(EVEN - change).loss
    assert start.slope @ change == pytest.approx(0.5 * rise, rel=1e-4)
    fitted = fit(EVEN, CELLS.trace(), [(1.0, misfit)], 60, bounds=CELL_BOUNDS)
    assert misfit.evaluate(fitted).error.mean() < 0.25 * start.error.mean()
    logarithm = np.log(fitted / EVEN)
    assert logarithm.min() >= CELL_BOUNDS[0]
    assert logarithm.max() <= CELL_BOUNDS[1]


def linear_answers(moduli, load):
    factor = CELLS.factor(CELLS.rest_tangent(moduli))
    pushed = np.zeros((len(load), *MODEL.rest.shape))
    pushed[:, : ORGAN.n_surface] = load
    moved = np.zeros((len(load), MODEL.rest.size))
    moved[:, CELLS.free] = factor.solve(np.ascontiguousarray(pushed.reshape(len(load), -1)[:, CELLS.free].T)).T
    return moved.reshape(pushed.shape)[:, : ORGAN.n_surface]


def test_a_calibration_of_cells_begins_with_cells_and_one_of_springs_without():
    cells = pipeline.prepared(ball(2), pipeline.Settings(method="cells"))
    assert cells.n_interior == round(0.6 * cells.n_surface)
    assert pipeline.prepared(cells, pipeline.Settings(method="cells", interior=30)).n_interior == 30
    mu, lam = cells.lame_moduli
    np.testing.assert_allclose(cells.cell_mu, mu)
    np.testing.assert_allclose(cells.cell_lambda, 0.5 * lam)
    assert cells.hardening == ball(2).hardening
    assert not len(pipeline.prepared(cells, pipeline.Settings()).cell_nodes)
