"""Places where balls are pressed: flat, clear of the clamp, far from each other."""

import numpy as np
import pytest

from helpers.scenes import RADIUS
from tissue_sim.identification.places import KINDS, flat_locations, thickness
from tissue_sim.organ.tool_resolution import mean_edge


def test_places_are_clear_of_the_clamp_and_of_each_other(organ):
    places = flat_locations(organ, 3)
    assert [[spot.kind for spot in spots] for spots in places] == [list(KINDS)] * 3
    points = np.array([[spot.point for spot in spots] for spots in places])
    held, edge = organ.surface_positions[organ.fixed], mean_edge(organ)
    assert np.linalg.norm(points.reshape(-1, 1, 3) - held, axis=2).min() > 4.0 * edge
    assert min(np.linalg.norm(points[a] - points[b], axis=1).min() for a, b in ((0, 1), (0, 2), (1, 2))) > 4.0 * edge
    np.testing.assert_allclose(np.linalg.norm(points[:, 0], axis=1), RADIUS)
    assert (np.linalg.norm(points[:, 2], axis=1) < RADIUS - 1e-5).all(), "in a triangle the ball is chamfered"
    for spots in places:
        np.testing.assert_allclose(spots[0].direction, -spots[2].point / np.linalg.norm(spots[2].point), atol=0.02)
        assert thickness(organ, spots[2]) == pytest.approx(2.0 * RADIUS, rel=0.02)
