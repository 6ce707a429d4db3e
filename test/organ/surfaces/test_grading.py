"""A surface with shorter edges in some places stays closed, on its wall, and even between."""

import numpy as np
import pytest

from helpers.shapes import ball, solid
from tissue_sim.errors import UserError
from tissue_sim.organ.surfaces.balloon import fibonacci_sphere
from tissue_sim.organ.surfaces.grading import graded
from tissue_sim.organ.surfaces.sizing import GROWTH, local_edges
from tissue_sim.organ.surfaces.surface import make_wall, measure

RADIUS, POINTS, SHORT = 18.0, 300, 1.5  # mm


@pytest.fixture(scope="module")
def globe():
    """A wall around a ball, its middle (3,) mm on the wall's grid, and an even surface of it."""
    wall = make_wall(solid(ball(RADIUS)))
    middle = wall.points().mean(axis=0)
    positions, triangles = fibonacci_sphere(POINTS)
    return wall, middle, middle + RADIUS * positions, triangles


def test_edges_become_as_short_as_wanted_and_no_shorter_elsewhere(globe):
    wall, middle, positions, triangles = globe
    pole = middle + [0.0, 0.0, RADIUS]

    def wanted(points):
        return SHORT + GROWTH * np.maximum(np.linalg.norm(points - pole, axis=1) - 6.0, 0.0)

    found, faces = graded(positions, triangles, wall, wanted, 5000)
    edges, apart = local_edges(found, faces), np.linalg.norm(found - pole, axis=1)
    assert edges[apart < 6.0].mean() == pytest.approx(SHORT, rel=0.12)
    far = local_edges(positions, triangles).mean()
    assert edges[apart > 25.0].mean() == pytest.approx(far, rel=0.1)
    quality = measure(found, faces)
    assert (quality.euler, quality.open_edges, quality.self_intersections) == (2, 0, 0)
    assert len(faces) == 2 * len(found) - 4
    assert POINTS < len(found) < 1000
    assert quality.least_angle > 20.0
    assert quality.volume == pytest.approx(4 / 3 * np.pi * RADIUS**3, rel=0.03)
    assert abs(wall.sample(found)).max() < 0.5


def test_longer_edges_than_there_are_change_nothing(globe):
    wall, _, positions, triangles = globe
    found, _ = graded(positions, triangles, wall, lambda points: np.full(len(points), 50.0), 5000)
    assert len(found) == POINTS


def test_too_many_points_are_refused(globe):
    wall, _, positions, triangles = globe
    with pytest.raises(UserError, match="--refine asks for more than 800 points"):
        graded(positions, triangles, wall, lambda points: np.full(len(points), 0.5), 800)
