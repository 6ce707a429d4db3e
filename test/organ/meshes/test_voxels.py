"""Voxels inside a surface."""

import numpy as np

from tissue_sim.organ.meshes.voxels import enclosed, off_grid
from tissue_sim.organ.surfaces.balloon import fibonacci_sphere


def test_a_sphere_encloses_the_voxels_within_its_radius():
    positions, triangles = fibonacci_sphere(3000)
    solid = enclosed(off_grid(20.0 + 12.0 * positions), triangles, np.array([41, 42, 43]))
    assert solid.shape == (43, 42, 41)
    z, y, x = np.indices(solid.shape)
    radius = np.sqrt((x - 20) ** 2 + (y - 20) ** 2 + (z - 20) ** 2)
    assert solid[radius < 11.8].all()
    assert not solid[radius > 12.1].any()


def test_a_box_on_the_grid_planes_is_filled_without_streaks():
    corner = np.array([[x, y, z] for z in (5.0, 15.0) for y in (4.0, 14.0) for x in (3.0, 13.0)])
    quads = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    triangles = np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))], dtype=np.int32)
    solid = enclosed(off_grid(corner), triangles, np.array([20, 20, 20]))
    assert solid.sum() == 1000
    assert solid[6:16, 5:15, 4:14].all()


def test_what_reaches_beyond_the_grid_is_clipped():
    positions, triangles = fibonacci_sphere(500)
    solid = enclosed(off_grid(5.0 + 20.0 * positions), triangles, np.array([10, 10, 10]))
    assert solid.all()
