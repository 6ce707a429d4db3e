"""Places of blades, against a search of all cells and NumPy's inverse."""

import numpy as np
import pytest

from helpers.slabs import SIZE, slab
from tissue_sim.model.contact.blade_places import locate, write_inverse
from tissue_sim.model.cutting.cut_cells import cut_cells_of
from tissue_sim.model.data.blades import BladeSample


def weights(cells, place):
    """Barycentric weights of a place in all cells, (c, 4)."""
    return cells.base + cells.slope @ place


def test_a_place_is_found_from_any_cell():
    cells, random = cut_cells_of(slab()), np.random.default_rng(0)
    sample, found = BladeSample.new(), np.zeros(8)
    for place in random.uniform(0.001, 0.999, (50, 3)) * SIZE:
        sample.rest[:], sample.cell = place, random.integers(len(cells.nodes))
        assert locate(cells, sample, found)
        holding = np.flatnonzero((weights(cells, place) > -1e-12).all(axis=1))
        assert sample.cell in holding
        assert np.allclose(found[:4], weights(cells, place)[sample.cell])


@pytest.mark.parametrize("place", [[0.02, 0.015, 0.032], [-0.001, 0.015, 0.015]])
def test_a_place_outside_is_told(place):
    cells = cut_cells_of(slab())
    sample, found = BladeSample.new(), np.zeros(8)
    sample.rest[:] = place
    assert not locate(cells, sample, found)


def test_the_inverse_is_numpys():
    random = np.random.default_rng(1)
    inverse = np.zeros(9)
    for _ in range(20):
        matrix = np.eye(3) + 0.2 * random.standard_normal((3, 3))
        write_inverse(matrix.ravel(), inverse)
        assert np.allclose(inverse.reshape(3, 3) @ matrix, np.eye(3), atol=1e-12)


def test_what_is_nearly_flat_tells_nothing_and_none_is_large():
    inverse = np.zeros(9)
    write_inverse(np.diag([1.0, 1.0, 0.01]).ravel(), inverse)
    assert not inverse.any()
    write_inverse(np.diag([0.2, 1.0, 1.0]).ravel(), inverse)
    assert np.linalg.norm(inverse) == pytest.approx(4.0)
