"""The phantom looks like an abdomen: sizes, intensities, neighbours that touch."""

import numpy as np
from scipy.ndimage import binary_dilation, binary_erosion

from tissue_sim.organ.imaging.phantom import FAT, KIDNEY, PhantomParameters, make_phantom


def extent(volume):
    index = np.argwhere(volume.array)[:, ::-1]
    return (np.ptp(index, axis=0) + 1) * volume.spacing


def test_the_kidney_has_a_kidneys_size_and_a_hilum(phantom):
    across, deep, tall = extent(phantom.kidney)
    assert 45 < across < 65
    assert 35 < deep < 48
    assert 100 < tall < 120
    volume = phantom.kidney.array.sum() * phantom.kidney.voxel_volume
    assert 110 < volume < 160
    assert phantom.kidney.array[tuple(np.round(phantom.ct.to_index(phantom.seed_point)).astype(int)[::-1])]
    hilum = np.round(phantom.ct.to_index([66 - 25, 36, 0])).astype(int)
    assert not phantom.kidney.array[tuple(hilum[::-1])]


def test_intensities_and_noise_are_as_asked(phantom):
    inner = binary_erosion(phantom.kidney.array, iterations=4)
    values = phantom.ct.array[inner]
    assert abs(values.mean() - KIDNEY) < 1.0
    assert abs(values.std() - 12.0) < 1.0
    assert phantom.ct.array.min() < -950


def test_neighbours_touch_and_a_gap_parts_them():
    coarse = (2.0, 2.0, 2.5)
    phantom = make_phantom(PhantomParameters(noise=0.0, blur=0.01, spacing=coarse))
    rim = binary_dilation(phantom.kidney.array, iterations=2) & ~binary_dilation(phantom.kidney.array)
    touching = np.mean(phantom.ct.array[rim] > 0.0)
    assert 0.05 < touching < 0.6
    apart = make_phantom(PhantomParameters(noise=0.0, blur=0.01, gap=6.0, spacing=coarse))
    assert np.mean(apart.ct.array[rim] > 0.0) < 0.01
    assert abs(np.median(apart.ct.array[rim]) - FAT) < 1.0


def test_the_same_seed_gives_the_same_voxels():
    small = PhantomParameters(spacing=(6.0, 6.0, 8.0))
    first, second = make_phantom(small), make_phantom(small)
    np.testing.assert_array_equal(first.ct.array, second.ct.array)
    other = make_phantom(PhantomParameters(spacing=(6.0, 6.0, 8.0), seed=1))
    assert np.any(other.ct.array != first.ct.array)
