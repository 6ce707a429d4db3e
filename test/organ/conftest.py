"""One phantom, segmented once, for all tests of the organ pipeline."""

import pytest

from tissue_sim.organ.imaging.phantom import make_phantom
from tissue_sim.organ.segmenting.segmentation import segment
from tissue_sim.organ.surfaces.surface import make_wall


@pytest.fixture(scope="session")
def phantom():
    return make_phantom()


@pytest.fixture(scope="session")
def segmented(phantom):
    return segment(phantom.ct, phantom.seed_point)


@pytest.fixture(scope="session")
def kidney_wall(segmented):
    return make_wall(segmented.mask)
