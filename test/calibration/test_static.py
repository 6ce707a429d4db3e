"""Settled shapes by Newton's method: against the force kernels, finite differences and the simulation itself."""

from dataclasses import replace

import numpy as np
import pytest

from helpers.scenes import ball, changed, kidney
from tissue_sim.calibration.static import Springs, settle
from tissue_sim.model.assembly import assemble
from tissue_sim.model.energy import energy_of
from tissue_sim.model.forces import elastic_forces
from tissue_sim.model.modes import free_axes, stiffness_matrix
from tissue_sim.model.simulation import Simulation

HARD = replace(ball(2), hardening=1.6)
SOFT = replace(changed(ball(2), return_stiffness=0.05), hardening=1.6)


def parts(organ):
    model = assemble(organ)
    springs = Springs(model)
    return model, springs, springs.stiffness_of(model)


def shaken(model, size, seed=0):
    """The rest shape with every free node moved at random."""
    x = model.rest.copy()
    x[model.moving] += size * np.random.default_rng(seed).standard_normal((len(model.moving), 3))
    return x


def push(organ, newton):
    """A push down on the top of the ball."""
    force = np.zeros((organ.n_surface, 3))
    top = np.argsort(-organ.surface_positions[:, 2])[:7]
    force[top] = [0.3 * newton / 7, 0.0, -newton / 7]
    return force


@pytest.mark.parametrize("size", [1e-4, 1e-3, 1e-2])
def test_energy_and_gradient_are_those_of_the_model(size):
    model, springs, stiffness = parts(HARD)
    x = shaken(model, size)
    force = np.zeros_like(x)
    elastic_forces(model, x, force)
    energy, gradient = springs.energy_and_gradient(x, stiffness)
    assert np.abs(gradient + force).max() < 1e-12 * np.abs(force).max()
    assert energy == pytest.approx(energy_of(model, x, np.zeros_like(x)).elastic, rel=1e-12)


@pytest.mark.parametrize("size", [1e-4, 1e-3, 5e-3])
def test_tangent_is_the_slope_of_the_gradient(size):
    model, springs, stiffness = parts(HARD)
    x = shaken(model, size)
    way = np.zeros(x.size)
    way[springs.free] = np.random.default_rng(1).standard_normal(len(springs.free))
    way = way.reshape(x.shape)
    step = 1e-8
    ahead, behind = (springs.energy_and_gradient(x + sign * step * way, stiffness)[1] for sign in (1.0, -1.0))
    expected = ((ahead - behind) / (2.0 * step)).ravel()[springs.free]
    found = springs.tangent(x, stiffness) @ way.ravel()[springs.free]
    assert np.linalg.norm(found - expected) < 1e-5 * np.linalg.norm(expected)


def test_tangent_at_rest_is_the_stiffness_matrix_and_its_trace():
    model, springs, stiffness = parts(kidney())
    free = free_axes(model)
    expected = stiffness_matrix(model)[free][:, free]
    assert abs(springs.rest_tangent(stiffness) - expected).max() < 1e-12 * abs(expected).max()
    held = np.setdiff1d(np.arange(3 * len(model.rest)), free)
    of_all = stiffness_matrix(model).diagonal()
    assert springs.trace() @ stiffness == pytest.approx(of_all[free].sum() + of_all[held].sum(), rel=1e-12)


def test_strain_rows_make_the_stiffness_matrix():
    _, springs, stiffness = parts(HARD)
    rows, owner = springs.strain_rows()
    made = rows.T @ (rows * stiffness[owner][:, None]).tocsc()
    assert abs(made - springs.rest_tangent(stiffness)).max() < 1e-12 * abs(made).max()
    answer, adjoint = np.random.default_rng(2).standard_normal((2, made.shape[0], 5))
    work = springs.rest_sensitivity(answer, adjoint) @ stiffness
    assert work == pytest.approx(float(np.vdot(adjoint, made @ answer)), rel=1e-9)


def test_convex_tangent_is_positive_definite_where_the_tangent_is_not():
    model, springs, stiffness = parts(SOFT)
    x = shaken(model, 8e-3)
    assert not springs.factor(springs.tangent(x, stiffness)).is_positive
    assert springs.factor(springs.tangent(x, stiffness, convex=True)).is_positive


def test_factor_solves_one_and_many():
    _, springs, stiffness = parts(HARD)
    matrix = springs.rest_tangent(stiffness)
    right = np.random.default_rng(2).standard_normal((len(springs.free), 150))
    factor = springs.factor(matrix)
    answer = factor.solve(right)
    assert np.abs(matrix @ answer - right).max() < 1e-9
    np.testing.assert_allclose(factor.solve(right[:, 3]), answer[:, 3], rtol=1e-9)


@pytest.mark.parametrize(("newton", "depth"), [(0.05, 3e-4), (0.5, 2e-3), (1.0, 4e-3)])
def test_settled_shape_is_where_the_simulation_comes_to_rest(newton, depth):
    model, springs, stiffness = parts(SOFT)
    force = push(SOFT, newton)
    settled, factor = settle(springs, stiffness, force)
    assert settled.converged
    assert settled.stable
    assert factor is not None
    wanted, rested = Simulation(SOFT).settle(force, 1e-7, 30.0)
    assert rested
    found = (settled.position - model.rest)[: SOFT.n_surface]
    assert np.linalg.norm(found - wanted) < 1e-5 * np.linalg.norm(wanted)
    assert np.abs(wanted).max() > depth


def test_a_start_and_a_factor_nearby_lead_to_the_same_shape():
    _, springs, stiffness = parts(SOFT)
    force = push(SOFT, 0.5)
    nearby, factor = settle(springs, 1.05 * stiffness, force)
    cold, _ = settle(springs, stiffness, force)
    warm, _ = settle(springs, stiffness, force, nearby.position, factor)
    np.testing.assert_allclose(warm.position, cold.position, atol=1e-9)


def test_what_does_not_converge_says_so():
    _, springs, stiffness = parts(SOFT)
    settled, factor = settle(springs, stiffness, push(SOFT, 0.5), iterations=1)
    assert not settled.converged
    assert factor is None
