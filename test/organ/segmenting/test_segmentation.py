"""One seed, the whole kidney, and nothing of its neighbours; a wrong seed and a leak are reported."""

from dataclasses import fields

import numpy as np
import pytest
import SimpleITK as sitk

from tissue_sim.errors import UserError
from tissue_sim.organ.imaging.image import Volume, from_sitk
from tissue_sim.organ.imaging.phantom import Phantom, PhantomParameters, make_phantom
from tissue_sim.organ.segmenting.segmentation import SegmentationParameters, dice, segment

ONE_WINDOW = SegmentationParameters(window=3.3)  # for what has nothing to do with how a window is chosen


@pytest.fixture(scope="module")
def small(coarse, around):
    """A coarser phantom, close around its kidney."""
    return Phantom(around(coarse, coarse.ct), around(coarse, coarse.kidney), coarse.seed_point)


@pytest.fixture(scope="module")
def stages():
    """What the progress of `small_kidney` was."""
    return []


@pytest.fixture(scope="module")
def small_kidney(small, stages):
    return segment(small.ct, small.seed_point, progress=lambda stage, fraction: stages.append((stage, fraction)))


@pytest.mark.extended
@pytest.mark.parametrize("noise", [pytest.param(20.0, marks=pytest.mark.slow), 30.0])
def test_more_noise_still_gives_the_kidney(around, noise, capsys):
    noisy = make_phantom(PhantomParameters(noise=noise))
    overlap = dice(segment(around(noisy, noisy.ct), noisy.seed_point).mask, noisy.kidney)
    with capsys.disabled():
        print(f"\nphantom, noise {noise:g} HU: Dice {overlap:.4f}")
    assert overlap >= 0.97


@pytest.mark.extended
@pytest.mark.parametrize(
    "offset",
    [
        (-13.4, 11.8, -6.3),
        pytest.param((14.0, 0.0, -22.0), marks=pytest.mark.slow),
        pytest.param((-4.0, 3.0, 25.0), marks=pytest.mark.slow),
    ],
)
def test_any_seed_inside_gives_the_same_kidney(small, small_kidney, offset):
    other = segment(small.ct, small.seed_point + np.array(offset))
    assert dice(other.mask, small.kidney) >= 0.96
    assert dice(other.mask, small_kidney.mask) >= 0.97


@pytest.mark.extended
def test_progress_runs_up(small_kidney, stages):
    fractions = [fraction for _, fraction in stages]
    assert fractions == sorted(fractions)
    assert fractions[0] == 0.0
    assert fractions[-1] <= 1.0
    assert all(stage for stage, _ in stages)


def test_a_leak_into_the_neighbours_is_refused(coarse):
    """Without a fat gap, a wide window that parts at the thinnest necks only: neighbours run together with it."""
    wide = SegmentationParameters(window=6.0, neck=0.2, grid=2.5)
    with pytest.raises(
        UserError, match=r"does not fit the anatomy of the kidney: it has .* move the seed .* lower --window"
    ) as caught:
        segment(coarse.ct, coarse.seed_point, wide, organ="kidney")
    assert "\n" not in str(caught.value)
    leaked = segment(coarse.ct, coarse.seed_point, wide, organ="kidney", accept=True)
    assert 350.0 < leaked.volume < 1000.0
    assert any("does not fit the anatomy of the kidney" in line for line in leaked.warnings)


@pytest.mark.slow
def test_a_leak_is_refused_when_no_organ_is_named(coarse):
    wide = SegmentationParameters(window=5.0, erosion=1.0)
    with pytest.raises(UserError, match=r"does not fit the anatomy of the organ: it has .*neck \d+ mm wide"):
        segment(coarse.ct, coarse.seed_point, wide, organ=None)


def test_too_deep_an_erosion_is_refused(small):
    with pytest.raises(UserError, match="lower --erosion"):
        segment(small.ct, small.seed_point, SegmentationParameters(erosion=40.0))


def test_every_parameter_says_what_it_is_and_where_it_ends():
    for entry in fields(SegmentationParameters):
        assert entry.metadata["help"]
        assert entry.metadata["unit"]
        low, high = entry.metadata["range"]
        option = "--" + entry.name.replace("_", "-")
        for wrong in (low - 1.0, high + 1.0, float("nan")):
            with pytest.raises(UserError, match=f"{option} .* must lie within"):
                SegmentationParameters(**{entry.name: wrong})


def test_seeds_that_are_no_organ(coarse):
    for point, what in {(-138.0, -80.0, 0.0): "lies in air", (66.0, 38.0, 60.0): "lies in fat"}.items():
        with pytest.raises(UserError, match=what) as caught:
            segment(coarse.ct, np.array(point))
        assert "move it into the organ" in str(caught.value)


def test_a_seed_outside_the_image_names_the_range(phantom):
    with pytest.raises(UserError, match=r"seed 500,38,0 mm is outside phantom, which spans x -143\.\.143") as caught:
        segment(phantom.ct, np.array([500.0, 38.0, 0.0]))
    assert "--seed-voxel" not in str(caught.value)


def test_voxel_indices_given_as_millimetres_get_a_hint(phantom):
    with pytest.raises(UserError, match=r"use --seed-voxel"):
        segment(phantom.ct, np.array([150.0, 95.0, 40.0]))


@pytest.mark.extended
def test_an_organ_cut_by_the_image_is_refused(small):
    index = np.round(small.ct.to_index(small.seed_point)).astype(int)
    lower = small.ct.crop((0, 0, 0), (*small.ct.size[:2], index[2] + 5))
    seed = small.seed_point - np.array([0.0, 0.0, 20.0])
    with pytest.raises(UserError, match=r"reaches the image's border, so part of it is missing.*--accept"):
        segment(lower, seed, ONE_WINDOW)
    cut = segment(lower, seed, ONE_WINDOW, accept=True)
    assert cut.at_edge
    assert any("border" in line for line in cut.warnings)


def permuted(volume, order, flips):
    """The same image with its voxel axes (x, y, z) in another order and direction."""
    array = np.transpose(volume.array, [2 - order[2 - k] for k in range(3)])
    spacing, direction = volume.spacing[list(order)], volume.direction[:, list(order)].copy()
    origin = volume.origin.copy()
    for k in flips:
        n = array.shape[2 - k]
        origin = origin + (n - 1) * spacing[k] * direction[:, k]
        direction[:, k] *= -1.0
        array = np.flip(array, axis=2 - k)
    return Volume(np.ascontiguousarray(array), spacing, origin, direction, "turned")


@pytest.mark.slow
def test_the_same_patient_saved_sideways(small, small_kidney):
    turned = permuted(small.ct, (1, 2, 0), (0, 2))
    np.testing.assert_allclose(turned.to_points(turned.to_index(small.seed_point)), small.seed_point)
    again = segment(turned, small.seed_point)
    assert np.array_equal(again.mask.direction, np.eye(3))
    assert dice(again.mask, small_kidney.mask) > 0.999


@pytest.mark.extended
def test_the_same_patient_saved_obliquely(coarse, small, small_kidney):
    """Resampled along axes turned by 20 degrees: the wall stays within half a voxel."""
    angle = np.deg2rad(20.0)
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    middle = small.ct.to_points((np.array(small.ct.size) - 1) / 2)
    size, spacing = [61, 57, 59], [2.0, 2.0, 2.5]
    origin = middle - turn @ ((np.array(size) - 1) / 2 * spacing)
    image = sitk.Resample(
        coarse.ct.to_sitk(),
        size,
        sitk.Transform(),
        sitk.sitkBSpline,
        origin.tolist(),
        spacing,
        turn.ravel().tolist(),
        -1000.0,
        sitk.sitkFloat32,
    )
    oblique = segment(from_sitk(image, "oblique"), small.seed_point, ONE_WINDOW).mask
    first, second = small_kidney.mask, oblique
    assert dice(second, first) > 0.97
    centres = [v.to_points(np.argwhere(v.array)[:, ::-1]).mean(axis=0) for v in (first, second)]
    assert np.linalg.norm(centres[0] - centres[1]) < 0.5
