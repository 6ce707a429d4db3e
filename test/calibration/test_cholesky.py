"""Cholesky by nested dissection against SciPy's LU."""

import numpy as np
import pytest
from scipy.sparse.linalg import splu

from helpers.blocks import box
from tissue_sim.calibration.cholesky import NotPositive


@pytest.fixture(scope="module")
def held_box():
    solid = box(np.linspace(0.0, 2.0, 5), np.linspace(0.0, 1.0, 4), np.linspace(0.0, 1.0, 4), bend=0.03)
    solid.held[solid.nodes[:, 0] == 0.0] = True
    solid.held[solid.nodes[:, 1] == 0.0, 1] = True  # single axes too
    return solid


def test_solutions_are_those_of_lu(held_box):
    loads = np.random.default_rng(0).normal(size=(5, *held_box.nodes.shape))
    free = np.flatnonzero(~held_box.held.ravel())
    matrix = held_box.stiffness.tocsr()[free][:, free].tocsc()
    wanted = np.zeros((5, held_box.nodes.size))
    wanted[:, free] = splu(matrix).solve(loads.reshape(5, -1)[:, free].T).T
    found = held_box.solve(loads).reshape(5, -1)
    np.testing.assert_allclose(found, wanted, rtol=0.0, atol=1e-10 * np.abs(wanted).max())


def test_single_precision_is_near(held_box):
    load = np.random.default_rng(1).normal(size=held_box.nodes.shape)
    wanted = held_box.solve(load[None])[0]
    found = held_box.factor(np.zeros_like(load)).precondition(load.reshape(-1, 1)).reshape(load.shape)
    assert 0.0 < np.linalg.norm(found - wanted) < 1e-4 * np.linalg.norm(wanted)


def test_shifted_by_the_mass(held_box):
    load = np.where(held_box.held, 0.0, np.random.default_rng(2).normal(size=held_box.nodes.shape))
    found = held_box.factor(np.zeros_like(load), shift=50.0).solve(load.reshape(-1, 1)).reshape(load.shape)
    back = (held_box.stiffness @ found.ravel()).reshape(load.shape) + 50.0 * (held_box.mass @ found)
    np.testing.assert_allclose(back[~held_box.held], load[~held_box.held], atol=1e-9)


def test_body_that_nothing_holds_has_no_factor():
    solid = box([0.0, 1.0], [0.0, 1.0], [0.0, 1.0])
    with pytest.raises(NotPositive):
        solid.factor(np.zeros_like(solid.nodes), shift=-1.0)
