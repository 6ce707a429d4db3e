"""Multi-stage segmentation of one organ from one seed (Gu, Xu & Peters; Zhang, Gu et al. 2006, section 2).

A survey of the seed's surroundings finds how far the organ reaches and which intensity window shows it best; then the
stages (stages.py) run on a fine grid around it, and the result is compared with the anatomy.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import SimpleITK as sitk
from numpy.typing import ArrayLike, NDArray

from tissue_sim.array_types import Mask, Singles
from tissue_sim.errors import UserError
from tissue_sim.organ.imaging.image import Volume
from tissue_sim.organ.segmenting.anatomy import anatomy_of, measure_shape, misfits
from tissue_sim.organ.segmenting.parameters import SegmentationParameters
from tissue_sim.organ.segmenting.region import Index
from tissue_sim.organ.segmenting.stages import (
    SMOOTHINGS,
    WINDOWS,
    Seed,
    Segmentation,
    ball_at,
    gaussian,
    point_text,
    segment_crop,
    smooth_for,
    voxel_at,
)
from tissue_sim.organ.segmenting.working import default_spacing, resample, within

__all__ = ["Progress", "Segmentation", "SegmentationParameters", "check_seed", "dice", "segment", "working_grid"]

Progress = Callable[[str, float], None]

_SURVEY_GRID = 3.0  # mm, first pass: how far does the organ reach?
_CLOSE_REACH = 155.0  # mm, more than a kidney's length
_SURVEY_REACH = 250.0  # mm around the seed, if the organ isn't smaller
_SURVEY_VOXELS = 80.0  # from the seed, at least
_MARGINS = (18.0, 45.0)  # mm around the surveyed organ in the second pass
_FAT = (-160.0, -40.0)  # HU
_SOFT_TISSUE = (-30.0, 400.0)  # HU at a seed that can be an organ
_CALM = 2.0  # HU, of what the smoothing leaves of the noise
_COMPACT = 0.9  # solidity beyond which more makes no difference
_GROSS = 2.0  # times the organ's greatest volume, from which a leak isn't examined closely
_CHOICES = 2  # windows examined closely, as long as the first doesn't fit


def _quiet(_stage: str, _done: float) -> None:
    return None


def segment(
    ct: Volume,
    seed: ArrayLike,
    parameters: SegmentationParameters | None = None,
    organ: str | None = None,
    accept: bool = False,
    progress: Progress | None = None,
) -> Segmentation:
    """Segment the organ around a seed point.

    Parameters
    ----------
    ct : Volume
        The image.
    seed : ArrayLike, shape (3,), mm
        Point in the organ, in the patient frame (LPS).
    parameters : SegmentationParameters | None, optional
        Parameters; None for the usual ones.
    organ : str | None, optional
        Name of the organ whose bounds are checked (see anatomy.ORGANS); None for the bounds of any organ.
    accept : bool, optional
        Whether a result that is out of bounds, cut by the image or leaked is passed on with warnings.
    progress : Progress | None, optional
        Called with the stage and the fraction done.

    Returns
    -------
    Segmentation
        The organ's mask and how it was found.

    Raises
    ------
    UserError
        Where the seed lies outside the image, in air, fat or bone, where nothing organ-like is found around it, and,
        unless `accept`, where the result can't be the organ.
    """
    p, report = parameters or SegmentationParameters(), progress or _quiet
    bounds = anatomy_of(organ)
    point = np.asarray(seed, dtype=np.float64)
    check_seed(ct, point)
    report("examining the seed's surroundings", 0.0)
    p, mean, deviation = _at_seed(ct, point, p)
    # An organ that isn't named may be small: its neighbourhood is looked at closely first.
    reaches = (min(bounds.longest[1], _SURVEY_REACH),) if organ else (_CLOSE_REACH, _SURVEY_REACH)
    for reach in reaches:
        tried = _surveys(ct, Seed(point, mean, deviation), p, reach, organ, report)
        if any(found.fits and not found.ran_out for found in tried):
            break
    results: list[Segmentation] = []
    for k, (fits, _, _, survey, window) in enumerate(tried[:_CHOICES]):
        if not fits and not accept and survey.volume > _GROSS * bounds.volume[1]:
            results.append(survey)
            continue
        report("segmenting the organ", 0.5 + 0.4 * k / _CHOICES)
        try:
            result = _closely(ct, point, replace(p, window=window), survey)
        except UserError:
            result = survey  # it leaked, and its intensity went with it
        results.append(result)
        if not misfits(result.mask, result.mean, organ):
            results = [result]
            break
    report("checking the organ", 0.95)
    return _checked(ct, results[0], point, organ, accept)


class _Survey(NamedTuple):
    """Rough segmentation by one window: whether it may be the organ, and whether it ran out of its surroundings."""

    fits: bool
    ran_out: bool
    score: float
    found: Segmentation
    window: float


def _surveys(
    ct: Volume,
    start: Seed,
    p: SegmentationParameters,
    reach: float,
    organ: str | None,
    report: Progress,
) -> list[_Survey]:
    """Return rough segmentations within `reach` mm of the seed, one per intensity window, the likeliest first."""
    around = np.array([start.point - reach, start.point + reach])
    crop = resample(ct, around, max(min(reach / _SURVEY_VOXELS, _SURVEY_GRID), working_grid(ct, p)))
    inside = within(ct, crop)
    smoothed = smooth_for(crop, p)
    most = anatomy_of(organ).volume[1]
    tried: list[_Survey] = []
    windows = (p.window,) if p.window else WINDOWS
    for k, window in enumerate(windows):
        report("measuring the organ", 0.1 + 0.4 * k / len(windows))
        try:
            found = segment_crop(crop, inside, start, replace(p, window=window), smoothed, most)
        except UserError:
            if k == len(windows) - 1 and not tried:
                raise
            continue
        score = found.clarity * min(measure_shape(found.mask).solidity, _COMPACT)
        fits = not misfits(found.mask, found.mean, organ)
        tried.append(_Survey(fits, _ran_out(found.mask, _clear_of_border(ct, found.mask)), score, found, window))
    return sorted(tried, key=lambda survey: (survey.fits, survey.score), reverse=True)


def _closely(ct: Volume, point: NDArray[np.float64], p: SegmentationParameters, survey: Segmentation) -> Segmentation:
    """Return the segmentation on a fine grid around the survey's result, on a larger one where that is too small."""
    found = survey.mask.to_points(np.argwhere(survey.mask.array)[:, ::-1])
    for margin in _MARGINS:
        around = np.array([found.min(axis=0) - margin, found.max(axis=0) + margin])
        crop = resample(ct, around, working_grid(ct, p))
        result = segment_crop(crop, within(ct, crop), Seed(point, survey.mean, survey.deviation), p)
        if not _ran_out(result.mask, _clear_of_border(ct, result.mask)):
            break
    return result


def _checked(
    ct: Volume, result: Segmentation, point: NDArray[np.float64], organ: str | None, accept: bool
) -> Segmentation:
    """Return the result with its warnings; raises UserError where it can't be passed on."""
    name = organ or "organ"
    warnings = []
    clear = _clear_of_border(ct, result.mask)
    result = replace(result, at_edge=bool(np.any(result.mask.array & ~clear)))
    if _ran_out(result.mask, clear):
        warnings.append(
            f"the region around seed {point_text(point)} mm leaves the {name}'s surroundings, so it leaks into a"
            " neighbour; move the seed to the organ's middle, lower --window or set --erosion deeper"
        )
    if result.at_edge:
        warnings.append(f"the {name} reaches the image's border, so part of it is missing; use a larger image")
    wrong = misfits(result.mask, result.mean, organ)
    if wrong:
        small = all("at least" in line and "hull" not in line for line in wrong)
        hint = "raise --window" if small else "lower --window or set --erosion deeper"
        warnings.append(
            f"the region found around seed {point_text(point)} mm does not fit the anatomy of the {name}: it has"
            f" {' and '.join(wrong)}; move the seed to the organ's middle, {hint}, or name another --organ"
        )
    if warnings and not accept:
        raise UserError(f"{warnings[-1]}; --accept accepts it as it is")
    return replace(result, warnings=tuple(warnings))


def _clear_of_border(ct: Volume, mask: Volume) -> Mask:
    """Return which voxels of a mask's grid are clear of the image's border, whose last voxels show the organ cut."""
    return within(ct, mask, margin=0.5 * float(ct.spacing.max()) + 1.01 * float(mask.spacing[0]))


def _ran_out(mask: Volume, clear: Mask) -> bool:
    """Return whether a mask reaches the faces of its grid where the image continues."""
    inner = mask.array & clear
    return any(bool(np.take(inner, side, axis=axis).any()) for axis in range(3) for side in (0, -1))


def working_grid(ct: Volume, p: SegmentationParameters) -> float:
    """Return the spacing of the isotropic grid on which the organ is segmented, mm."""
    return p.grid or default_spacing(ct)


def check_seed(ct: Volume, point: NDArray[np.float64]) -> None:
    """Raise UserError unless the image contains `point` (3,) mm."""
    index = ct.to_index(point)
    if ct.contains(index):
        return
    corners = ct.to_points(np.stack(np.meshgrid(*((0, n - 1) for n in ct.size)), axis=-1).reshape(-1, 3))
    ranges = ", ".join(
        f"{axis} {low:.0f}..{high:.0f}"
        for axis, low, high in zip("xyz", corners.min(axis=0), corners.max(axis=0), strict=True)
    )
    hint = ""
    if np.all(point >= 0) and np.all(point <= np.array(ct.size) - 1) and np.all(point == np.round(point)):
        hint = "; if these are voxel indices, use --seed-voxel"
    name = ct.name or "the image"
    raise UserError(f"seed {point_text(point)} mm is outside {name}, which spans {ranges} mm (LPS){hint}")


def _at_seed(
    ct: Volume, point: NDArray[np.float64], p: SegmentationParameters
) -> tuple[SegmentationParameters, float, float]:
    """Return parameters with their smoothing, and mean and deviation, HU, of smoothed intensities around the seed.

    Refuses what is not soft tissue.
    """
    reach = 2.0 * p.seed_radius + 3.0 * (p.smoothing or SMOOTHINGS[-1])
    crop = resample(ct, np.array([point - reach, point + reach]), working_grid(ct, p))
    radius, at = p.seed_radius / crop.spacing[0], voxel_at(crop, point)
    for sigma in (p.smoothing,) if p.smoothing else SMOOTHINGS:
        smooth = gaussian(crop, sigma)
        mean, deviation, ball = _calmest(smooth, at, radius)
        if 1.4826 * np.median(np.abs(smooth - gaussian(crop, 2.0 * sigma))[ball]) < _CALM:
            break
    deviation = float(np.clip(deviation, p.least_deviation, 2.0 * p.least_deviation))
    _check_tissue(mean, point)
    return replace(p, smoothing=sigma), mean, deviation


def _calmest(smooth: Singles, at: Index, radius: float) -> tuple[float, float, Mask]:
    """Return median, robust deviation and voxels of the most uniform ball of `radius` voxels that holds `at`.

    Near the wall the ball around the seed would mix the organ with what lies beyond (Kuwahara's idea).
    """
    best = 0.0, np.inf, np.zeros(smooth.shape, dtype=bool)
    step = 0.4 * radius
    for offset in np.ndindex(5, 5, 5):
        move = (np.array(offset) - 2) * step
        centre = tuple(round(i + m) for i, m in zip(at, move, strict=True))
        if np.linalg.norm(move) > 0.85 * radius:
            continue
        ball = ball_at(smooth.shape, centre, radius)  # type: ignore[arg-type]
        values = smooth[ball]
        if not len(values):
            continue
        median = float(np.median(values))
        deviation = 1.4826 * float(np.median(np.abs(values - median)))
        if deviation < best[1] - 1e-9:
            best = median, deviation, ball
    return best


def _check_tissue(mean: float, point: NDArray[np.float64]) -> None:
    low, high = _SOFT_TISSUE
    if low <= mean <= high:
        return
    what = "bone or metal" if mean > high else "fat" if mean > _FAT[0] else "air, outside the body or in gas"
    raise UserError(f"seed {point_text(point)} mm lies in {what} ({mean:.0f} HU); move it into the organ")


def dice(first: Volume, second: Volume) -> float:
    """Return the Dice overlap of two bool masks; the first is resampled onto the second's grid."""
    image = first.with_array(first.array.astype(np.float32)).to_sitk()
    there = sitk.Resample(image, second.to_sitk(), sitk.Transform(), sitk.sitkLinear, 0.0, sitk.sitkFloat32)
    moved = sitk.GetArrayFromImage(there) >= 0.5
    both, first_count, second_count = (int(np.count_nonzero(m)) for m in (moved & second.array, moved, second.array))
    return 2.0 * both / max(first_count + second_count, 1)
