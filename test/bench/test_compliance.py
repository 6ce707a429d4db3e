"""The precomputed compliance against what the model settles to."""

import numpy as np
import pytest

from helpers.scenes import ball
from tissue_sim.bench.compliance import Product, surface_compliance
from tissue_sim.bench.organs import patch_load
from tissue_sim.model.simulation import Simulation


def settled(organ, nodes, forces):
    whole = np.zeros((organ.n_surface, 3))
    whole[nodes] = forces
    displacement, done = Simulation(organ).settle(whole, tolerance=1e-6)
    assert done
    return displacement


@pytest.mark.extended
def test_product_is_what_a_tiny_load_settles_to():
    organ = ball(2)
    nodes, forces = patch_load(organ, 1e-4)
    model = Simulation(organ).model
    product = Product(surface_compliance(model, nodes), forces)
    assert np.median(product(9)) > 0.0
    expected = settled(organ, nodes, forces)
    error = np.linalg.norm(product.displacement.reshape(-1, 3) - expected) / np.linalg.norm(expected)
    assert error < 1e-3


def test_all_points_hold_the_patch_and_are_symmetric():
    organ = ball(2)
    model = Simulation(organ).model
    whole = surface_compliance(model, np.arange(organ.n_surface))
    assert whole.dtype == np.float32
    assert np.abs(whole - whole.T).max() < 1e-4 * np.abs(whole).max()
    nodes, _ = patch_load(organ, 1.0)
    columns = (3 * nodes[:, None] + np.arange(3)).ravel()
    np.testing.assert_allclose(whole[:, columns], surface_compliance(model, nodes), rtol=1e-5, atol=1e-9)


def test_held_nodes_neither_move_nor_move_others():
    organ = ball(2)
    held = organ.fixed.astype(np.int64)
    whole = surface_compliance(Simulation(organ).model, np.arange(organ.n_surface))
    rows = (3 * held[:, None] + np.arange(3)).ravel()
    assert not np.any(whole[rows])
    assert not np.any(whole[:, rows])
