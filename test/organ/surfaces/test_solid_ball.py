"""Topological balls from solids with handles and cavities."""

import numpy as np
import pytest
from skimage.measure import euler_number

from tissue_sim.errors import UserError
from tissue_sim.organ.surfaces.solid_ball import as_ball, flip_simple


def grid(size=40):
    return np.indices((size, size, size)) - 0.5 * (size - 1)


def euler(solid):
    return euler_number(solid, connectivity=1)


def test_a_ball_stays_as_it_is():
    z, y, x = grid()
    solid = x**2 + y**2 + z**2 < 15**2
    np.testing.assert_array_equal(as_ball(solid, "ball"), solid)


def test_a_cavity_is_filled():
    z, y, x = grid()
    radius = np.sqrt(x**2 + y**2 + z**2)
    np.testing.assert_array_equal(as_ball((radius < 15) & (radius > 4), "shell"), radius < 15)


def test_a_narrow_hole_is_filled_by_a_membrane():
    z, y, x = grid()
    bored = (x**2 + y**2 + z**2 < 15**2) & (np.hypot(x, y) > 2.0)
    assert euler(bored) == 0
    ball = as_ball(bored, "bored")
    assert euler(ball) == 1
    assert not (bored & ~ball).any()
    assert 0 < (ball & ~bored).sum() < 40  # a disk of 2 voxels radius, not the whole hole of some 360


def test_a_thin_handle_is_cut():
    z, y, x = grid()
    solid = x**2 + y**2 + (z + 6) ** 2 < 10**2
    handle = (np.abs(np.hypot(x, z - 4) - 8) < 1.6) & (np.abs(y) < 1.6) & (z > 0)
    ball = as_ball(solid | handle, "jug")
    assert euler(solid | handle) == 0
    assert euler(ball) == 1
    assert not (ball & ~(solid | handle)).any()
    assert 0 < ((solid | handle) & ~ball).sum() < 30


def test_a_ring_is_refused():
    z, y, x = grid()
    with pytest.raises(UserError, match=r"ring has a through hole.*fill the hole or cut the ring.*--part N"):
        as_ball(np.hypot(np.hypot(x, y) - 13, z) < 4, "ring")


def test_growing_by_simple_voxels_keeps_a_ball():
    """Random voxels and order: whatever is reached stays a ball at every end."""
    rng = np.random.default_rng(11)
    for _ in range(5):
        allowed = rng.random((14, 14, 14)) < 0.7
        image = np.zeros(allowed.shape, dtype=np.uint8)
        image[7, 7, 7] = 1
        flip_simple(image, allowed, rng.random(allowed.shape), 1)
        assert image.sum() > 100
        assert euler(image == 1) == 1
        assert not ((image == 1) & ~allowed).sum() > 1  # the first voxel may lie outside
