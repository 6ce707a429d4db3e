"""The balloon: N points, 2N - 4 triangles, closed, even, on the wall; also in hollow and long organs."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from tissue_sim.errors import UserError
from tissue_sim.organ.balloon import fibonacci_sphere, inflate
from tissue_sim.organ.build import wall_distance
from tissue_sim.organ.surface import make_wall, marching_cubes_surface, measure

from .shapes import ball, solid


def assert_good(balloon, wall, points):
    assert balloon.positions.shape == (points, 3)
    assert balloon.triangles.shape == (2 * points - 4, 3)
    quality = measure(balloon.positions, balloon.triangles)
    assert (quality.euler, quality.open_edges, quality.self_intersections) == (2, 0, 0)
    assert quality.edge_variation < 0.25
    assert quality.least_angle > 20.0
    return quality


@pytest.mark.parametrize("points", [50, 994, 1001])
def test_a_fibonacci_sphere_has_2n_minus_4_triangles(points):
    positions, triangles = fibonacci_sphere(points)
    assert len(triangles) == 2 * points - 4
    quality = measure(positions, triangles)
    assert (quality.euler, quality.open_edges) == (2, 0)
    assert quality.volume > 0


def test_the_papers_mesh_on_the_kidney(kidney_wall):
    balloon = inflate(kidney_wall, 994)
    assert len(balloon.triangles) == 1984
    quality = assert_good(balloon, kidney_wall, 994)
    cubes = measure(*marching_cubes_surface(kidney_wall))
    assert abs(quality.volume / cubes.volume - 1) < 0.01
    assert wall_distance(kidney_wall, balloon.positions, balloon.triangles) < 0.2 * kidney_wall.spacing
    assert balloon.missed < balloon.edge


@pytest.mark.parametrize("points", [200, 3000])
def test_any_number_of_points(kidney_wall, points):
    assert_good(inflate(kidney_wall, points), kidney_wall, points)


def test_too_few_points_are_refused(kidney_wall):
    with pytest.raises(UserError, match="--points 20 is too few"):
        inflate(kidney_wall, 20)


def test_a_deep_groove_is_entered():
    """A ball with a groove to its middle: the expanding front meets itself behind the groove's wall."""

    def grooved(x, y, z):
        finger = np.maximum(np.hypot(x, y) - 5.0, 2.0 - z)
        return np.maximum(ball(20.0)(x, y, z), -finger)

    wall = make_wall(solid(grooved))
    balloon = inflate(wall, 994)
    assert_good(balloon, wall, 994)
    assert balloon.missed < balloon.edge
    bottom = 0.5 * wall.spacing * (np.array(wall.level.shape[::-1]) - 1) + np.array([0.0, 0.0, 2.0])
    bottom[2] = np.flatnonzero(wall.level[:, wall.level.shape[1] // 2, wall.level.shape[2] // 2] < 0)[-1] * wall.spacing
    assert cKDTree(balloon.positions).query(bottom)[0] < balloon.edge


def test_a_long_bent_organ_is_filled():
    def horseshoe(x, y, z):
        arc = np.hypot(np.hypot(x, np.maximum(y, 0.0)) - 22.0, z) - 6.0
        legs = np.hypot(np.abs(x) - 22.0, z) - 6.0
        return np.where(y > 0, arc, np.maximum(legs, -15.0 - y))

    wall = make_wall(solid(horseshoe, size=(66, 60, 24)))
    balloon = inflate(wall, 800)
    assert_good(balloon, wall, 800)
    assert balloon.missed < balloon.edge
