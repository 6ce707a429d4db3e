"""Separate parts of a mask: reported with their volumes, and taken one, or all."""

import numpy as np
import pytest

from tissue_sim.errors import UserError
from tissue_sim.organ.imaging.image import Volume
from tissue_sim.organ.imaging.mask_parts import one_part

SPACING = np.array([1.0, 1.0, 2.0])  # mL per voxel: 0.002


def balls(*placed):
    """A mask of balls, (middle's x, radius) mm each."""
    z, y, x = np.indices((30, 50, 120))
    array = np.zeros(x.shape, dtype=bool)
    for middle, radius in placed:
        array |= (x - middle) ** 2 + (y - 25.0) ** 2 + (2.0 * (z - 15.0)) ** 2 <= radius**2
    return Volume(array, SPACING, np.zeros(3), np.eye(3), "mask.nrrd")


def volume(mask):
    return float(mask.array.sum()) * mask.voxel_volume


def test_parts_are_refused_with_their_volumes_or_one_is_taken():
    both = balls((25, 20), (85, 16))
    large, small = volume(balls((25, 20))), volume(balls((85, 16)))
    with pytest.raises(UserError) as caught:
        one_part(both)
    assert f"mask mask.nrrd has 2 separate parts: 1 {large:.3g} mL, 2 {small:.3g} mL" in str(caught.value)
    assert "--part N (1 is the largest), or join all with --merge-parts" in str(caught.value)
    assert "\n" not in str(caught.value)
    for part, kept, left in ((1, large, small), (2, small, large)):
        found = one_part(both, part)
        assert volume(found) == pytest.approx(kept)
        assert found.notes == (f"omitted 1 separate part of {left:.3g} mL next to {kept:.3g} mL",)
    with pytest.raises(UserError, match=r"has no part 3; it contains 1 "):
        one_part(both, 3)
    with pytest.raises(UserError, match="has no part 2: it has a single part"):
        one_part(balls((25, 20)), 2)


def test_scraps_are_left_out_and_reported():
    found = one_part(balls((25, 20), (60, 5)))
    np.testing.assert_array_equal(found.array, balls((25, 20)).array)
    assert found.notes[0].startswith("omitted 1 separate part of 0.5")
    whole = balls((25, 20))
    assert one_part(whole) is whole


def test_parts_close_by_are_joined():
    both = balls((25, 20), (64, 16))  # 3 mm apart
    found = one_part(both, merge=True)
    assert np.all(found.array[both.array])
    filled = volume(found) - volume(both)
    assert 0.0 < filled < 0.1 * volume(both)
    assert found.notes == (f"joined 2 separate parts across gaps of up to 3 mm: {filled:.3g} mL filled between",)
    assert one_part(found) is found


def test_parts_far_apart_are_not_joined():
    with pytest.raises(UserError, match=r"parts 25 mm apart, too far for one organ; build each with --part N"):
        one_part(balls((25, 20), (86, 16)), merge=True)


def test_parts_that_touch_by_an_edge_are_joined_by_more():
    array = np.zeros((12, 20, 20), dtype=bool)
    array[1:11, 1:10, 1:10] = array[1:11, 10:19, 10:19] = True
    found = one_part(Volume(array, np.ones(3), np.zeros(3), np.eye(3), "edge"), merge=True)
    assert found.array[5, 9, 10]
    assert found.array[5, 10, 9]
