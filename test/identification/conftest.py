"""A ball of cells, a place on it, and presses of it that the model itself has made."""

import numpy as np
import pytest

from helpers.scenes import ball_of_cells
from tissue_sim.calibration.cases import surface_of
from tissue_sim.identification.measured import MeasuredPress, Measurement
from tissue_sim.identification.places import flat_locations
from tissue_sim.identification.press_curves import curves_of

FINGER = 0.007  # m
DEPTHS = np.concatenate([np.linspace(-6e-4, -1e-4, 4), np.linspace(1e-4, 2e-3, 12)])


@pytest.fixture(scope="session")
def organ():
    return ball_of_cells()


@pytest.fixture(scope="session")
def places(organ):
    return flat_locations(organ, 1)


@pytest.fixture(scope="session")
def presses(organ):
    """Places of four presses, and the model's curves there."""
    surface = surface_of(organ)
    nodes = [
        int(np.argmax(surface.normal @ direction))
        for direction in ([0, 0, 1.0], [1.0, 0, 0.4], [0, 1.0, 0.4], [-1, -1, 0.4])
    ]
    made = [
        MeasuredPress(
            f"press {number}",
            DEPTHS,
            np.zeros_like(DEPTHS),
            surface.positions[node] + FINGER * surface.normal[node],
            -surface.normal[node],
            np.zeros((0, 3)),
        )
        for number, node in enumerate(nodes)
    ]
    measurement = Measurement("the model", FINGER, made, [], [], True)
    return measurement, curves_of(organ, measurement, 0.6)
