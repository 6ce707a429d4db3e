"""One seed, the whole kidney, and nothing of its neighbours; a wrong seed is told apart."""

import numpy as np
import pytest

from tissue_sim.errors import UserError
from tissue_sim.organ.phantom import PhantomParameters, make_phantom
from tissue_sim.organ.segmentation import SegmentationParameters, dice, segment


def test_the_phantoms_kidney(phantom, segmented):
    assert dice(segmented.mask, phantom.kidney) >= 0.965
    true = phantom.kidney.array.sum() * phantom.kidney.voxel_volume
    assert abs(segmented.volume - true) < 0.05 * true
    assert not segmented.at_edge
    assert abs(segmented.mean - 32.0) < 3.0
    assert -45.0 < segmented.wall < -25.0


@pytest.mark.parametrize("offset", [(14.0, 0.0, -22.0), (-4.0, 3.0, 25.0)])
def test_any_seed_inside_gives_the_same_kidney(phantom, segmented, offset):
    other = segment(phantom.ct, phantom.seed_point + np.array(offset))
    assert dice(other.mask, phantom.kidney) >= 0.96


def test_more_noise_still_gives_the_kidney():
    noisy = make_phantom(PhantomParameters(noise=20.0))
    assert dice(segment(noisy.ct, noisy.seed_point).mask, noisy.kidney) >= 0.95


def test_without_erosion_the_neighbours_are_not_parted(phantom):
    """The stages matter: a wide window without erosion floods the abdomen, and that is told."""
    with pytest.raises(UserError, match="leaks into its neighbours"):
        segment(phantom.ct, phantom.seed_point, SegmentationParameters(window=20.0, erosion=0.1))


def test_too_deep_an_erosion_is_refused(phantom):
    with pytest.raises(UserError, match="lower --erosion"):
        segment(phantom.ct, phantom.seed_point, SegmentationParameters(erosion=40.0))


def test_seeds_that_are_no_organ(phantom):
    for point, what in {
        (-138.0, -80.0, 0.0): "lies in air",
        (66.0, 38.0, 60.0): "lies in fat",
        (0.0, 40.0, 0.0): "",
    }.items():
        if what:
            with pytest.raises(UserError, match=what) as caught:
                segment(phantom.ct, np.array(point))
            assert "move it into the organ" in str(caught.value)


def test_a_seed_outside_the_image_names_the_range(phantom):
    with pytest.raises(UserError, match=r"seed 500,38,0 mm lies outside phantom, which spans x -143\.\.143") as caught:
        segment(phantom.ct, np.array([500.0, 38.0, 0.0]))
    assert "--seed-voxel" not in str(caught.value)


def test_voxel_indices_given_as_millimetres_get_a_hint(phantom):
    with pytest.raises(UserError, match=r"use --seed-voxel"):
        segment(phantom.ct, np.array([150.0, 95.0, 40.0]))


def test_an_organ_cut_by_the_image_is_noted(phantom):
    index = np.round(phantom.ct.to_index(phantom.seed_point)).astype(int)
    lower = phantom.ct.crop((0, 0, 0), (*phantom.ct.size[:2], index[2] + 5))
    assert segment(lower, phantom.seed_point - np.array([0.0, 0.0, 20.0])).at_edge
