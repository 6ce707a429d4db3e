"""Centrelines of shapes whose middle is known."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from tissue_sim.errors import UserError
from tissue_sim.organ.skeleton import extract
from tissue_sim.organ.surface import make_wall

from .shapes import ball, solid


def patient_mm(wall, skeleton):
    return wall.to_patient(skeleton.positions) * 1e3


def test_a_bent_tube():
    """Quarter of a torus: middle on a circle of 40 mm, radius 8 mm, to within a voxel."""

    def tube(x, y, z):
        u, v = x + 30.0, y + 30.0
        section = np.hypot(np.hypot(u, v) - 40.0, z) - 8.0
        return np.maximum(section, np.maximum(4.0 - u, 4.0 - v))

    wall = make_wall(solid(tube, size=(90, 90, 26)))
    skeleton = extract(wall, 48)
    points = patient_mm(wall, skeleton) + np.array([30.0, 30.0, 0.0])
    offset = np.hypot(np.hypot(points[:, 0], points[:, 1]) - 40.0, points[:, 2])
    assert offset.mean() < 0.5
    assert offset.max() < 1.0
    assert np.abs(skeleton.radius[5:-5] - 8.0).max() < 0.7
    assert skeleton.length > 0.6 * (np.pi / 2 * 40.0 - 8.0)


def test_atoms_are_even_inside_and_a_chain(kidney_wall):
    skeleton = extract(kidney_wall, 48)
    assert skeleton.positions.shape == (48, 3)
    np.testing.assert_array_equal(skeleton.parent, np.arange(-1, 47))
    gaps = np.linalg.norm(np.diff(skeleton.positions, axis=0), axis=1)
    assert gaps.std() < 0.02 * gaps.mean()
    assert np.all(kidney_wall.sample(skeleton.positions) < -5.0)
    np.testing.assert_allclose(skeleton.radius, -kidney_wall.sample(skeleton.positions), atol=0.8 * kidney_wall.spacing)


def test_an_ellipsoids_skeleton_is_its_long_axis():
    def ellipsoid(x, y, z):
        return np.sqrt((x / 10) ** 2 + (y / 12) ** 2 + (z / 35) ** 2) - 1.0

    wall = make_wall(solid(ellipsoid, size=(30, 34, 80)))
    points = patient_mm(wall, extract(wall, 20))
    assert np.hypot(points[:, 0], points[:, 1]).max() < 1.0
    assert 45.0 < np.ptp(points[:, 2]) < 62.0


def test_the_balls_skeleton_is_short_and_central():
    wall = make_wall(solid(ball(18.0)))
    points = patient_mm(wall, extract(wall, 7))
    assert np.linalg.norm(points, axis=1).max() < 9.0
    one = extract(wall, 1)
    assert one.positions.shape == (1, 3)
    assert np.linalg.norm(patient_mm(wall, one)) < 1.5
    assert one.radius[0] == pytest.approx(18.0, abs=1.2)


def test_the_middle_is_found_between_voxels_of_any_spacing():
    def rod(x, y, z):
        return np.maximum(np.hypot(x - 0.4, y - 0.3) - 7.0, np.abs(z) - 30.0)

    wall = make_wall(solid(rod, spacing=(1.0, 1.2, 2.5), size=(24, 20, 32)))
    points = patient_mm(wall, extract(wall, 30))
    away = cKDTree(np.stack([np.full(601, 0.4), np.full(601, 0.3), np.linspace(-30, 30, 601)], axis=1)).query(points)[0]
    assert away.mean() < 0.3
    assert away.max() < 1.2


def test_thin_organs_and_no_atoms_are_refused():
    wall = make_wall(solid(ball(18.0)))
    with pytest.raises(UserError, match="--atoms 0 is too few"):
        extract(wall, 0)

    def sheet(x, y, z):
        return np.maximum(np.abs(z) - 1.2, np.hypot(x, y) - 18.0)

    with pytest.raises(UserError, match="too thin"):
        extract(make_wall(solid(sheet)), 48)
