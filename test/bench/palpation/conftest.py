"""A ball of cells, and a place on it."""

import pytest

from helpers.scenes import ball_of_cells
from tissue_sim.identification.places import flat_locations


@pytest.fixture(scope="module")
def organ():
    return ball_of_cells()


@pytest.fixture(scope="module")
def places(organ):
    return flat_locations(organ, 1)
