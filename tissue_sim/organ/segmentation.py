"""Multi-stage segmentation of one organ from one seed (Gu, Xu & Peters; Zhang, Gu et al. 2006, section 2).

Stages: threshold around the seed's intensity; erosion until the seed's region separates from its
neighbours; fast marching from the seed inside the eroded region; morphological reconstruction of the
front under the eroded mask; dilation back to the wall. Erosion and dilation by a ball are thresholds of
the exact Euclidean distance, so depths are millimetres on any grid. While the organ dilates, so do its
neighbours: where two meet, the border stays.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import SimpleITK as sitk
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage
from skimage.segmentation import watershed

from tissue_sim.errors import UserError
from tissue_sim.organ.image import Volume, from_sitk

Mask = NDArray[np.bool_]
Field = NDArray[np.float32]
Index = tuple[int, int, int]

_SURVEY_GRID = 3.0  # mm, first pass: how far does the organ reach?
_SURVEY_REACH = 250.0  # mm around the seed
_MARGIN = 18.0  # mm around the surveyed organ in the second pass
_LARGEST = 2500.0  # mL, more than any organ that is meant here: the region has leaked
_FAT = (-160.0, -40.0)  # HU
_SOFT_TISSUE = (-30.0, 400.0)  # HU at a seed that can be an organ
_NEIGHBOURHOOD = 60.0  # mm around the seed in which the dark side (fat) is looked for
_NECK = 0.5  # a neck narrower than this share of the smaller lobe's depth parts two organs
_LOBE = 0.03  # volume share from which a lobe that breaks off counts
_EROSION = (1.5, 10.0)  # mm, least and greatest depth tried
_REFINEMENTS = 3
_SPUR = 3.0  # mm, radius of the final opening
_CALMER = (np.inf, 2.0, 1.2)  # bounds of the deviation, in least deviations, tried one after another on a leak


@dataclass(frozen=True)
class SegmentationParameters:
    """What can be tuned; lengths in mm. None: worked out from the image."""

    smoothing: float = 2.5  # Gaussian, standard deviation, before intensities are compared
    wall_smoothing: float = 1.0  # the same before the wall is located
    window: float = 3.0  # half-width of the intensity window in standard deviations
    least_deviation: float = 3.0  # HU; a homogeneous organ's deviation is taken as no less
    seed_radius: float = 7.0  # ball whose intensities start the window
    growth: float = 1.2  # the organ's deviation may exceed the one around the seed by this factor
    erosion: float | None = None  # depth; None: until the seed's region separates
    grid: float | None = None  # spacing of the isotropic working grid; None: half the coarsest, 1 to 1.5


@dataclass(frozen=True, eq=False)
class Segmentation:
    """One organ: its mask on the working grid, and how it was found.

    mask: bool Volume. mean, deviation HU of the organ; wall HU: half-way to the fat; erosion mm;
    volume mL; at_edge: the organ reaches the image's border, so part of it is missing.
    """

    mask: Volume
    mean: float
    deviation: float
    wall: float
    erosion: float
    volume: float
    at_edge: bool

    def figures(self) -> dict[str, Any]:
        """What goes into the provenance."""
        figures = {key: round(getattr(self, key), 3) for key in ("mean", "deviation", "wall", "erosion", "volume")}
        return figures | {"at_edge": self.at_edge, "grid_mm": float(self.mask.spacing[0])}


def segment(ct: Volume, seed: ArrayLike, parameters: SegmentationParameters | None = None) -> Segmentation:
    """Segment the organ around `seed`, (3,) mm in the patient frame (LPS).

    Raises UserError when the seed lies outside the image, in air, fat or bone, or when nothing
    organ-like is found around it.
    """
    p = parameters or SegmentationParameters()
    point = np.asarray(seed, dtype=np.float64)
    check_seed(ct, point)
    around = np.array([point - _SURVEY_REACH, point + _SURVEY_REACH])
    crop, _ = _working_crop(ct, around, max(_SURVEY_GRID, p.grid or 0.0))
    mean, deviation = _at_seed(ct, point, p)
    for calm in _CALMER:
        most = min(p.growth * deviation, calm * p.least_deviation)
        survey = _segment_crop(crop, point, p, (mean, min(deviation, most)), most)
        if survey.volume < _LARGEST:
            break
    else:
        raise UserError(
            f"the region around seed {_text(point)} mm leaks into its neighbours ({survey.volume:.0f} mL);"
            " move the seed to the organ's middle, lower --window or raise --erosion"
        )
    index = np.argwhere(survey.mask.array)[:, ::-1]
    inside = survey.mask.to_points(index)
    around = np.array([inside.min(axis=0) - _MARGIN, inside.max(axis=0) + _MARGIN])
    crop, own = _working_crop(ct, around, working_grid(ct, p))
    result = _segment_crop(crop, point, p, (survey.mean, survey.deviation), most)
    return replace(result, at_edge=bool(np.any(_faces_touched(result.mask.array) & own)))


def working_grid(ct: Volume, p: SegmentationParameters) -> float:
    """Spacing of the isotropic grid that the organ is segmented on, mm."""
    return p.grid or float(np.clip(ct.spacing.max() / 2.0, 1.0, 1.5))


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
    raise UserError(f"seed {_text(point)} mm lies outside {name}, which spans {ranges} mm (LPS){hint}")


def _text(point: NDArray[np.float64]) -> str:
    return ",".join(f"{value:g}" for value in np.round(point, 1))


def _working_crop(ct: Volume, box: NDArray[np.float64], spacing: float) -> tuple[Volume, NDArray[np.bool_]]:
    """The part of the image around `box` (2, 3) mm, its lower and upper corner, on an isotropic grid.

    Also says which of its six faces, order (axis z, y, x; low, high), are the image's own.
    """
    corners = ct.to_index([[box[i, 0], box[j, 1], box[k, 2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
    lower, upper = np.floor(corners.min(axis=0)).astype(int), np.ceil(corners.max(axis=0)).astype(int)
    own = np.stack([lower <= 0, upper >= np.array(ct.size) - 1], axis=1)[::-1]
    part = ct.crop(lower.tolist(), upper.tolist())
    size = np.floor((np.array(part.size) - 1) * part.spacing / spacing + 1e-6).astype(int) + 1
    image = sitk.Resample(
        part.to_sitk(),
        np.maximum(size, 2).tolist(),
        sitk.Transform(),
        sitk.sitkLinear,
        part.origin.tolist(),
        [spacing] * 3,
        part.direction.ravel().tolist(),
        float(part.array.min()),
        sitk.sitkFloat32,
    )
    return from_sitk(image, ct.name), own


def _faces_touched(mask: Mask) -> NDArray[np.bool_]:
    faces = [[mask[0].any(), mask[-1].any()], [mask[:, 0].any(), mask[:, -1].any()]]
    return np.array([*faces, [mask[:, :, 0].any(), mask[:, :, -1].any()]])


def _at_seed(ct: Volume, point: NDArray[np.float64], p: SegmentationParameters) -> tuple[float, float]:
    """Mean and deviation, HU, of the smoothed intensities around the seed. Refuses what is no soft tissue."""
    reach = 3.0 * (p.seed_radius + p.smoothing)
    crop, _ = _working_crop(ct, np.array([point - reach, point + reach]), working_grid(ct, p))
    smooth = sitk.GetArrayFromImage(sitk.SmoothingRecursiveGaussian(crop.to_sitk(), p.smoothing))
    ball = _ball_at(smooth.shape, _voxel(crop, point), p.seed_radius / crop.spacing[0])
    mean, deviation = _spread(smooth[ball], (p.least_deviation, np.inf))
    _check_tissue(mean, point)
    return mean, deviation


def _voxel(crop: Volume, point: NDArray[np.float64]) -> Index:
    """Array index (z, y, x) of the voxel nearest to a point, within the crop."""
    i, j, k = np.clip(np.round(crop.to_index(point)).astype(int), 0, np.array(crop.size) - 1)
    return int(k), int(j), int(i)


def _segment_crop(
    crop: Volume, point: NDArray[np.float64], p: SegmentationParameters, start: tuple[float, float], most: float
) -> Segmentation:
    """All stages on one isotropic crop, from a first mean and deviation, HU; the deviation stays below `most`.

    Without that bound a first small leak widens the window and so lets in the next.
    """
    h = float(crop.spacing[0])
    image = crop.to_sitk()
    smooth = sitk.GetArrayFromImage(sitk.SmoothingRecursiveGaussian(image, p.smoothing))
    sharp = sitk.GetArrayFromImage(sitk.SmoothingRecursiveGaussian(image, p.wall_smoothing))
    seed = _voxel(crop, point)
    mean, deviation = start
    dark = _dark_side(sharp, seed, mean, deviation, h)
    for _ in range(_REFINEMENTS):
        like = np.abs(smooth - mean) < p.window * deviation
        depth = ndimage.distance_transform_edt(like) * h
        apex = _ascend(depth, seed)
        if depth[apex] <= h:
            raise UserError(f"the tissue at seed {_text(point)} mm ({mean:.0f} HU) forms no region; move the seed")
        erosion = p.erosion if p.erosion is not None else _separation_depth(depth, apex, h)
        if erosion >= depth[apex]:
            raise UserError(
                f"erosion of {erosion:g} mm leaves nothing around seed {_text(point)} mm, whose region is"
                f" {depth[apex]:.1f} mm deep; lower --erosion"
            )
        labels, _n = ndimage.label(depth > erosion)
        eroded = labels == labels[apex]
        again = _spread(smooth[eroded], (p.least_deviation, most))
        settled = abs(again[0] - mean) < 1.0 and abs(again[1] - deviation) < 0.5
        if settled:
            break
        mean, deviation = again

    box = _box_around(eroded, (erosion + 2.0 * p.smoothing + 8.0) / h)
    smooth, sharp, labels, eroded = smooth[box], sharp[box], labels[box], eroded[box]
    local: Index = tuple(i - s.start for i, s in zip(apex, box, strict=True))  # type: ignore[assignment]
    core = _reconstruct(_front(smooth, eroded, local, mean, deviation), eroded)
    wall = 0.5 * (mean + dark)
    rivals = _rivals(smooth, sharp, labels, core, mean, p.window * deviation, wall, h)
    window = (wall, mean + max(150.0, 2.0 * p.window * deviation))
    mask = np.zeros(depth.shape, dtype=bool)
    mask[box] = _dilate_back(sharp, core, rivals, local, window, erosion + 2.0 * p.smoothing, h)
    return Segmentation(
        mask=crop.with_array(mask),
        mean=mean,
        deviation=deviation,
        wall=wall,
        erosion=float(erosion),
        volume=float(np.count_nonzero(mask)) * crop.voxel_volume,
        at_edge=False,
    )


def _box_around(mask: Mask, margin: float) -> tuple[slice, slice, slice]:
    """The mask's bounding box grown by `margin` voxels, clipped to the array."""
    box = ndimage.find_objects(mask.astype(np.uint8))[0]
    grow = int(np.ceil(margin))
    return tuple(slice(max(s.start - grow, 0), min(s.stop + grow, n)) for s, n in zip(box, mask.shape, strict=True))  # type: ignore[return-value]


def _ball_at(shape: tuple[int, ...], centre: Index, radius: float) -> Mask:
    axes = np.ogrid[tuple(slice(0, n) for n in shape)]
    squared = sum((axis - c) ** 2 for axis, c in zip(axes, centre, strict=True))
    return np.asarray(squared <= radius**2)


def _spread(values: Field, limits: tuple[float, float]) -> tuple[float, float]:
    """Median and robust standard deviation (from the median absolute deviation), within limits."""
    median = float(np.median(values))
    return median, float(np.clip(1.4826 * np.median(np.abs(values - median)), *limits))


def _check_tissue(mean: float, point: NDArray[np.float64]) -> None:
    low, high = _SOFT_TISSUE
    if low <= mean <= high:
        return
    what = "bone or metal" if mean > high else "fat" if mean > _FAT[0] else "air, outside the body or in gas"
    raise UserError(f"seed {_text(point)} mm lies in {what} ({mean:.0f} HU); move it into the organ")


def _dark_side(sharp: Field, seed: Index, mean: float, deviation: float, h: float) -> float:
    """Intensity of what surrounds the organ: fat, or whatever is clearly darker than the organ."""
    near = sharp[_ball_at(sharp.shape, seed, _NEIGHBOURHOOD / h)]
    fat = near[(near > _FAT[0]) & (near < _FAT[1])]
    if len(fat) > 0.005 * len(near):
        return float(np.median(fat))
    darker = near[near < mean - 6.0 * deviation]
    return float(np.median(darker)) if len(darker) else mean - 12.0 * deviation


def _ascend(depth: NDArray[np.float64], start: Index) -> Index:
    """Steepest ascent to the local maximum of depth; steps of up to two voxels pass over noise."""
    at = start
    while True:
        window = tuple(slice(max(i - 2, 0), i + 3) for i in at)
        block = depth[window]
        best = np.unravel_index(int(block.argmax()), block.shape)
        if block[best] <= depth[at]:
            return at
        at = tuple(s.start + int(b) for s, b in zip(window, best, strict=True))  # type: ignore[assignment]


def _separation_depth(depth: NDArray[np.float64], apex: Index, h: float) -> float:
    """Erosion depth, mm, past the last neck that joins the seed's region to another organ.

    Eroding step by step, a part that breaks off through a neck much narrower than either side is
    another organ; one that breaks off through a wide neck is a lobe of this one.
    """
    found = _EROSION[0]
    labels, _ = ndimage.label(depth > 0.0)
    region = labels == labels[apex]
    box = ndimage.find_objects(region.astype(np.uint8))[0]
    local = np.where(region[box], depth[box], 0.0)
    top = tuple(i - s.start for i, s in zip(apex, box, strict=True))
    for step in np.arange(0.5 * h, min(_NECK * depth[apex], _EROSION[1]), 0.5 * h):
        labels, count = ndimage.label(local > step)
        own = labels[top]
        if count > 1:
            index = np.arange(1, count + 1)
            volume = np.bincount(labels.ravel(), minlength=count + 1)[1:]
            deepest = ndimage.maximum(local, labels, index)
            narrow = step < _NECK * np.minimum(deepest, deepest[own - 1])
            if np.any(narrow & (volume > _LOBE * volume[own - 1]) & (index != own)):
                found = max(found, float(step))
        local = np.where(labels == own, local, 0.0)
    return found


def _front(smooth: Field, eroded: Mask, apex: Index, mean: float, deviation: float) -> Mask:
    """Fast marching from the seed through the eroded region, faster where the intensity fits.

    Stopped when half the region's voxels are reached: what is left is the reconstruction's.
    """
    speed = np.exp(-0.5 * ((smooth - mean) / deviation) ** 2) * eroded
    marching = sitk.FastMarchingImageFilter()
    marching.SetTrialPoints([[int(i) for i in apex[::-1]]])
    marching.SetStoppingValue(1e6)
    arrival = sitk.GetArrayFromImage(marching.Execute(sitk.GetImageFromArray(speed.astype(np.float32))))
    reached = eroded & (arrival < 1e6)
    stop = np.median(arrival[reached]) if reached.any() else 0.0
    front = reached & (arrival <= stop)
    front[apex] = True
    return front


def _reconstruct(front: Mask, eroded: Mask) -> Mask:
    """Binary morphological reconstruction of the front under the eroded mask."""
    marker, under = (sitk.GetImageFromArray(m.astype(np.uint8)) for m in (front, eroded))
    return sitk.GetArrayFromImage(sitk.BinaryReconstructionByDilation(marker, under)) != 0


def _rivals(
    smooth: Field, sharp: Field, labels: NDArray[np.int32], core: Mask, mean: float, width: float, wall: float, h: float
) -> Mask:
    """Voxels that surely belong to something else: other eroded regions, and tissue of other intensity.

    Darker tissue counts only 6 mm away from fat and gas, nearer it may be the organ's own blurred rim.
    """
    depth = ndimage.distance_transform_edt(sharp > wall) * h
    brighter = (smooth > mean + width) & (depth > h)
    darker = (smooth < mean - width) & (depth > 6.0)
    away = ndimage.distance_transform_edt(~core) * h > h
    return (brighter | darker | (labels > 0)) & away & ~core


def _dilate_back(
    sharp: Field, core: Mask, rivals: Mask, apex: Index, window: tuple[float, float], reach: float, h: float
) -> Mask:
    """Dilate the core back to the wall, at most `reach` mm, against its dilating rivals.

    Both grow at the same rate through the tissue between the wall's intensity and bone: a watershed
    of the distance to the nearer of the two. Spurs (vessels) thinner than 6 mm are opened away.
    """
    tissue = (sharp > window[0]) & (sharp < window[1]) | core
    to_core = (ndimage.distance_transform_edt(~core) * h).astype(np.float32)
    level = np.minimum(to_core, ndimage.distance_transform_edt(~rivals) * h) if rivals.any() else to_core
    basins = watershed(level, core * np.int32(1) + rivals * np.int32(2), mask=tissue)
    own = (basins == 1) & (to_core <= reach)
    own = _open(own, _SPUR / h) | core
    labels, _ = ndimage.label(own)
    return ndimage.binary_fill_holes(labels == labels[apex])


def _open(mask: Mask, radius: float) -> Mask:
    """Opening by a ball of `radius` voxels, through exact distances."""
    kept = ndimage.distance_transform_edt(mask) > radius
    return ndimage.distance_transform_edt(~kept) <= radius if kept.any() else kept


def dice(first: Volume, second: Volume) -> float:
    """Dice overlap of two bool masks; the first is resampled onto the second's grid."""
    image = first.with_array(first.array.astype(np.float32)).to_sitk()
    there = sitk.Resample(image, second.to_sitk(), sitk.Transform(), sitk.sitkLinear, 0.0, sitk.sitkFloat32)
    moved = sitk.GetArrayFromImage(there) >= 0.5
    both, first_count, second_count = (int(np.count_nonzero(m)) for m in (moved & second.array, moved, second.array))
    return 2.0 * both / max(first_count + second_count, 1)
