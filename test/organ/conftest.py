"""Phantoms, each painted once in a process, for all tests of how organs are made."""

import pytest

from helpers.phantoms import around_kidney, coarse_phantom, fine_phantom
from tissue_sim.organ.surfaces.surface import make_wall


@pytest.fixture(scope="session")
def phantom():
    return fine_phantom()


@pytest.fixture(scope="session")
def kidney_wall(phantom):
    """The wall of the kidney as it was painted: to segment it first would take several workers ten seconds each."""
    return make_wall(phantom.kidney)


@pytest.fixture(scope="session")
def coarse():
    return coarse_phantom()


@pytest.fixture(scope="session")
def around():
    return around_kidney
