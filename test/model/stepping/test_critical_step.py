"""The critical step against dense eigenvalues, and against runs that stay bounded or diverge."""

import math

import numpy as np
import pytest
from scipy.linalg import eigh
from scipy.sparse.linalg import LinearOperator, eigsh

from helpers.scenes import assembled, ball, changed, free_ball, kidney
from tissue_sim.model.elasticity.assembly import assemble
from tissue_sim.model.elasticity.forces import elastic_forces
from tissue_sim.model.elasticity.frequency import largest_frequency
from tissue_sim.model.stepping.critical_step import SAFETY, critical_step, model_step, stable_frequency, substeps_for
from tissue_sim.model.stepping.integrators import symplectic_euler


def force_at(model, x):
    force = np.zeros_like(x)
    elastic_forces(model, x, 1.0, force)
    return force


def modes(model):
    """Angular frequencies (rad/s, ascending) and mass-scaled modes of the moving nodes, from a dense K."""
    nodes = model.moving
    stiffness = np.zeros((3 * len(nodes), 3 * len(nodes)))
    for column, (node, axis) in enumerate((node, axis) for node in nodes for axis in range(3)):
        step = np.zeros_like(model.rest)
        step[node, axis] = 1e-8
        difference = force_at(model, model.rest + step) - force_at(model, model.rest - step)
        stiffness[:, column] = -difference[nodes].ravel() / 2e-8
    root = np.repeat(np.sqrt(model.inverse_mass[nodes]), 3)
    values, vectors = eigh(0.5 * (stiffness + stiffness.T) * np.outer(root, root))
    return np.sqrt(np.maximum(values, 0.0)), root[:, None] * vectors


@pytest.mark.parametrize("variant", ["surface", "volume", "hybrid"])
@pytest.mark.parametrize("organ", [ball(), free_ball()], ids=["held", "free"])
def test_largest_frequency_equals_the_dense_eigenvalue(organ, variant):
    model = assemble(organ, variant)
    assert largest_frequency(model) == pytest.approx(modes(model)[0][-1], rel=0.01)


@pytest.mark.parametrize("variant", ["surface", "volume", "hybrid"])
def test_largest_frequency_of_the_kidney_equals_the_one_by_lanczos(variant):
    model = assembled(kidney(), variant)
    root = np.sqrt(model.inverse_mass)[:, None]

    def product(vector):
        push = root * vector.reshape(-1, 3)
        step = 1e-8 * push / np.abs(push).max()
        difference = force_at(model, model.rest + step) - force_at(model, model.rest - step)
        return (-root * difference * np.abs(push).max() / 2e-8).ravel()

    size = model.rest.size
    operator = LinearOperator((size, size), matvec=product, dtype=np.float64)
    start = np.random.default_rng(1).standard_normal(size)
    (largest,) = eigsh(operator, k=1, which="LA", tol=1e-6, v0=start, return_eigenvectors=False)
    assert largest_frequency(model) == pytest.approx(math.sqrt(largest), rel=0.01)


def grown(model, step, steps=400):
    """Amplitude of the fastest mode after `steps`, over what it was; kernels alone, no guard."""
    _, vectors = modes(model)
    x, v = model.rest.copy(), np.zeros_like(model.rest)
    x[model.moving] += 1e-9 * (vectors[:, -1] / np.abs(vectors[:, -1]).max()).reshape(-1, 3)
    largest = 0.0
    for _ in range(steps):
        force = force_at(model, x)
        symplectic_euler(x, v, force, model.moving, model.inverse_mass, model.damping, 1.0, step)
        largest = np.abs(x - model.rest).max() / 1e-9
        if not largest < 1e4:
            break
    return largest


@pytest.mark.parametrize("variant", ["surface", "volume", "hybrid"])
@pytest.mark.parametrize("damping_ratio", [0.0, 0.4])
def test_run_is_bounded_just_under_the_critical_step_and_diverges_above(variant, damping_ratio):
    model = assemble(ball(), variant)
    frequency = largest_frequency(model)
    mass = np.divide(1.0, model.inverse_mass, where=model.inverse_mass > 0.0, out=np.zeros(len(model.rest)))
    model = model._replace(damping=2.0 * damping_ratio * frequency * mass)
    step = critical_step(frequency, damping_ratio)
    assert grown(model, 0.97 * step) < 10.0
    assert grown(model, 1.05 * step) > 1e4
    assert grown(model, 1.2 * step, steps=60) > 1e4


def test_frequency_grows_with_the_root_of_stiffness_over_mass():
    organ = ball()
    stiff = changed(organ, spring_stiffness=4.0, angular_stiffness=4.0, return_stiffness=4.0)
    heavy = changed(organ, mass=9.0)
    frequency = largest_frequency(assemble(organ))
    assert largest_frequency(assemble(stiff)) == pytest.approx(2.0 * frequency, rel=1e-3)
    assert largest_frequency(assemble(heavy)) == pytest.approx(frequency / 3.0, rel=1e-3)


@pytest.mark.parametrize("scale", [0.01, 1.0, 100.0])
def test_substeps_are_the_fewest_that_stay_under_the_safe_step(scale):
    model = assemble(changed(kidney(), damping=0.0))
    frequency = largest_frequency(model)
    substeps = substeps_for(1e-3, model_step(model, frequency, scale))
    safe = SAFETY * 2.0 / (frequency * math.sqrt(scale))
    assert 1e-3 / substeps <= safe
    assert substeps == 1 or 1e-3 / (substeps - 1) > safe


def test_kidney_needs_few_substeps():
    model = assemble(kidney())
    assert substeps_for(1e-3, model_step(model, largest_frequency(model))) <= 2


def test_organ_without_springs_or_without_free_nodes_has_no_critical_step():
    slack = assemble(changed(ball(), spring_stiffness=0.0, angular_stiffness=0.0, return_stiffness=0.0))
    assert largest_frequency(slack) == 0.0
    assert critical_step(0.0, 0.0) == math.inf
    assert model_step(slack, 0.0) == math.inf
    assert substeps_for(1e-3, math.inf) == 1
    model = assemble(ball())
    held = model._replace(inverse_mass=np.zeros_like(model.inverse_mass), moving=model.moving[:0])
    assert largest_frequency(held) == 0.0
    assert model_step(held, 5000.0) == math.inf


@pytest.mark.parametrize("rate", [0.0, 60.0, 3000.0])
def test_stable_frequency_is_the_one_of_that_critical_step(rate):
    frequency = stable_frequency(1.1e-3, rate)
    assert critical_step(frequency, rate / (2.0 * frequency)) == pytest.approx(1.1e-3)
