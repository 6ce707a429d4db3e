"""A ball of cells, and a place on it."""

import pytest

from helpers.scenes import ball_of_cells
from tissue_sim.bench.palpation.places import flat_places


@pytest.fixture(scope="module")
def organ():
    return ball_of_cells()


@pytest.fixture(scope="module")
def places(organ):
    return flat_places(organ, 1)
