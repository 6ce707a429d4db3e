"""The tangent as a function of stiffness: the model's own matrix, what it is made of, and its factors."""

from dataclasses import replace

import numpy as np
import pytest

from helpers.scenes import ball, changed, kidney
from tissue_sim.calibration.elastic import Elastic
from tissue_sim.model.elasticity.assembly import assemble
from tissue_sim.model.elasticity.modes import free_axes, stiffness_matrix, strains_of
from tissue_sim.organ.cell_mesh import with_cells
from tissue_sim.organ.topology import assemble_like

SPRINGS = changed(ball(2), return_stiffness=0.05)


def cells():
    organ = with_cells(assemble_like(ball(2), interior_atoms=40), (1.0, 0.5))
    factor = np.exp(np.random.default_rng(3).normal(size=(2, len(organ.cell_mu))))
    return replace(organ, cell_mu=factor[0] * organ.cell_mu, cell_lambda=factor[1] * organ.cell_lambda)


@pytest.fixture(scope="module", params=[lambda: SPRINGS, cells, kidney], ids=["springs", "cells", "kidney"])
def model(request):
    return assemble(request.param())


def test_it_is_the_models_own_matrix_and_trace(model):
    elastic, free = Elastic(model), free_axes(model)
    matrix = stiffness_matrix(model)
    wanted = matrix[free][:, free]
    found = elastic.tangent(elastic.stiffness)
    assert abs(found - wanted).max() < 1e-12 * abs(wanted).max()
    assert elastic.trace() @ elastic.stiffness == pytest.approx(matrix.diagonal().sum(), rel=1e-12)
    assert (elastic.n_nodes, elastic.n_surface) == (len(model.rest), model.n_surface)


def test_it_is_linear_in_stiffness_and_its_slope_is_the_sensitivity(model):
    elastic = Elastic(model)
    draw = np.random.default_rng(5)
    answer, adjoint = draw.standard_normal((2, len(elastic.free), 5))
    slope = elastic.sensitivity(answer, adjoint)
    rows, owner, _ = strains_of(model)
    rows = rows[:, elastic.free]
    work = np.bincount(owner, np.einsum("rc,rc->r", rows @ answer, rows @ adjoint), len(slope))
    np.testing.assert_allclose(slope, work, rtol=1e-9, atol=1e-11 * np.abs(work).max())
    other = elastic.stiffness * draw.uniform(0.2, 5.0, len(slope))
    assert slope @ other == pytest.approx(float(np.vdot(adjoint, elastic.tangent(other) @ answer)), rel=1e-9)


def test_factor_solves_one_and_many(model):
    elastic = Elastic(model)
    matrix = elastic.tangent(elastic.stiffness)
    right = np.random.default_rng(2).standard_normal((len(elastic.free), 20))
    factor = elastic.factor(matrix)
    assert factor.is_positive
    answer = factor.solve(right)
    assert np.abs(matrix @ answer - right).max() < 1e-7
    np.testing.assert_allclose(factor.solve(right[:, 3]), answer[:, 3], rtol=1e-7)
