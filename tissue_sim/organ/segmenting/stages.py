"""Stages of the segmentation on one grid; segmentation.py runs them.

Threshold, erosion until the organ is separate, fast marching, reconstruction, dilation (Zhang, Gu et al. 2006, section
2). Erosion and dilation by a ball are thresholds of the exact Euclidean distance, so depths are millimetres on any
grid.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import SimpleITK as sitk
from numpy.typing import NDArray
from scipy import ndimage
from skimage.segmentation import watershed

from tissue_sim.array_types import Mask, Singles
from tissue_sim.errors import UserError
from tissue_sim.json_types import JsonObject
from tissue_sim.organ.imaging.image import Volume
from tissue_sim.organ.segmenting.depth import depth_of
from tissue_sim.organ.segmenting.dilation import dilate, local_mean
from tissue_sim.organ.segmenting.parameters import SegmentationParameters
from tissue_sim.organ.segmenting.region import Box, Index, Region
from tissue_sim.organ.segmenting.separation import Parts, necks, part

SMOOTHINGS = (2.5, 3.0)  # mm, tried until the tissue at the seed is calm
WINDOWS = (2.5, 3.3, 4.3, 5.5)  # half-widths tried, in deviations
_FAT = (-160.0, -40.0)  # HU
_NEIGHBOURHOOD = 60.0  # mm around the seed in which the dark side (fat) is looked for
_LIGHT_FRACTION, _LIGHT = 0.15, (1.5, 3.0)  # of the depth; mm: least erosion, removes rims and sheets
_LOBE = 0.03  # fraction of the volume from which a neighbouring body counts
_MAJORITY = 1.5  # mm
_HOLE = 0.15  # mL, up to which a gap in the thresholded tissue is noise
_DRIFT, _DRIFT_WIDTH = 10.0, 20.0  # HU, mm: how far the organ's intensity may wander, and over what distance
_REFINEMENTS = 4
_CLEAR = 3.0  # deviations from the organ from which its surroundings are clearly something else


@dataclass(frozen=True, eq=False)
class Segmentation:
    """Mask of one organ on the working grid, and how it was found.

    Attributes
    ----------
    mask : Volume
        The bool mask.
    mean : float, HU
        Mean of the organ.
    deviation : float, HU
        Standard deviation of the organ.
    wall : float, HU
        Intensity halfway to fat, at which the wall lies.
    erosion : float, mm
        Depth of the erosion.
    volume : float, mL
        Volume of the mask.
    at_edge : bool
        Whether the organ reaches the image's border, so that a part is missing.
    smoothing : float, mm
        Smoothing as used.
    clarity : float
        Fraction of its surroundings that differs clearly from it.
    warnings : tuple[str, ...]
        What speaks against the organ that was asked for.
    """

    mask: Volume
    mean: float
    deviation: float
    wall: float
    erosion: float
    volume: float
    at_edge: bool
    smoothing: float = 0.0
    clarity: float = 0.0
    warnings: tuple[str, ...] = ()

    def figures(self) -> JsonObject:
        """Return the figures for the provenance."""
        names = ("mean", "deviation", "wall", "erosion", "volume", "smoothing")
        figures = {key: round(getattr(self, key), 3) for key in names}
        more = {"at_edge": self.at_edge, "grid_mm": float(self.mask.spacing[0]), "warnings": list(self.warnings)}
        return figures | more


def point_text(point: NDArray[np.float64]) -> str:
    """Return a point as messages show it.

    Parameters
    ----------
    point : NDArray[np.float64], shape (3,), mm
        The point.
    """
    return ",".join(f"{value:g}" for value in np.round(point, 1))


def gaussian(volume: Volume, sigma: float) -> Singles:
    """Return the image smoothed by a Gaussian.

    Parameters
    ----------
    volume : Volume
        The image.
    sigma : float, mm
        Standard deviation.

    Returns
    -------
    Singles, shape (nz, ny, nx), HU
        The smoothed image.
    """
    return sitk.GetArrayFromImage(sitk.SmoothingRecursiveGaussian(volume.to_sitk(), sigma))


def voxel_at(crop: Volume, point: NDArray[np.float64]) -> Index:
    """Return the array index (z, y, x) of the voxel nearest to a point, within the crop.

    Parameters
    ----------
    crop : Volume
        Image on the working grid.
    point : NDArray[np.float64], shape (3,), mm
        The point.

    Returns
    -------
    Index
        Array index.
    """
    i, j, k = np.clip(np.round(crop.to_index(point)).astype(int), 0, np.array(crop.size) - 1)
    return int(k), int(j), int(i)


def width_of(p: SegmentationParameters, deviation: float) -> float:
    """Return half of the intensity window, HU, of tissue with a deviation, HU."""
    return float(p.window or WINDOWS[1]) * deviation


def smooth_for(crop: Volume, p: SegmentationParameters) -> tuple[Singles, Singles]:
    """Return the crop smoothed to compare intensities, and smoothed to locate the wall.

    Parameters
    ----------
    crop : Volume
        Image on the working grid.
    p : SegmentationParameters
        Parameters of the segmentation.

    Returns
    -------
    tuple[Singles, Singles]
        Two images of shape (nz, ny, nx), HU.
    """
    return gaussian(crop, float(p.smoothing or SMOOTHINGS[0])), gaussian(crop, p.wall_smoothing)


class Seed(NamedTuple):
    """Where an organ's tissue is, (3,) mm, and the mean and the deviation that its intensity is first taken for, HU."""

    point: NDArray[np.float64]
    mean: float
    deviation: float


def segment_crop(
    crop: Volume,
    inside: Mask,
    start: Seed,
    p: SegmentationParameters,
    smoothed: tuple[Singles, Singles] | None = None,
    largest: float = np.inf,
) -> Segmentation:
    """Run all stages on one isotropic crop, from a first mean.

    The deviation may fall to the region's but doesn't grow with it: a small leak would widen the window and let in
    more.

    Parameters
    ----------
    crop : Volume
        Image on the working grid.
    inside : Mask, shape (nz, ny, nx)
        Which voxels lie in the image.
    start : Seed
        Seed point, with the first mean of the organ and the deviation there, HU.
    p : SegmentationParameters
        Parameters of the segmentation.
    smoothed : tuple[Singles, Singles] | None, optional
        Result of `smooth_for`, when several windows are tried on one crop.
    largest : float, mL, optional
        Volume from which an eroded region has leaked and isn't dilated.
    """
    point, mean, deviation = start
    h = float(crop.spacing[0])
    sigma = float(p.smoothing or SMOOTHINGS[0])
    smooth, sharp = smoothed or smooth_for(crop, p)
    seed = voxel_at(crop, point)
    dark = _dark_side(sharp, seed, mean, deviation, h)
    level: Singles = np.full(smooth.shape, mean, dtype=np.float32)
    for again in range(_REFINEMENTS):
        width = width_of(p, deviation)
        like = _majority(np.abs(smooth - level) < width, _MAJORITY / h) & inside
        like = _without_holes(like, _HOLE / crop.voxel_volume)
        next_depth = depth_of(like) * h
        next_apex = _ascend(next_depth, seed)
        if next_depth[next_apex] <= h:
            if again:
                break  # the region leaked and its intensity went with it; the last one stands, to be judged
            raise UserError(f"the tissue at seed {point_text(point)} mm ({mean:.0f} HU) forms no region; move the seed")
        depth, apex = next_depth, next_apex
        if p.erosion is not None and p.erosion >= depth[apex]:
            raise UserError(
                f"erosion of {p.erosion:g} mm leaves nothing around seed {point_text(point)} mm, whose region is"
                f" {depth[apex]:.1f} mm deep; lower --erosion"
            )
        parts = _parted(depth, p)
        body = int(parts.labels[apex])
        apex = _deepest(depth, parts.labels == body)
        light = float(np.clip(_LIGHT_FRACTION * depth[apex], *_LIGHT))
        labels, _ = ndimage.label((parts.labels == body) & (depth > light))
        eroded = labels == labels[apex]
        before, mean = mean, float(np.median(smooth[eroded]))
        calm = 1.4826 * float(np.median(np.abs(smooth[eroded] - mean)))
        deviation = float(np.clip(calm, p.least_deviation, deviation))
        drift, weight = local_mean(smooth, eroded, _DRIFT_WIDTH / h)
        level = np.where(weight > 1e-3, np.clip(drift, mean - _DRIFT, mean + _DRIFT), mean).astype(np.float32)
        if abs(mean - before) < 0.5:
            break

    between = necks(parts, depth, body)
    neighbours = (parts.volume > _LOBE * parts.volume[body]) & (np.arange(len(parts.volume)) > 0)
    neighbours[body] = False
    erosion = p.erosion if p.erosion is not None else max(float(between[neighbours].max(initial=0.0)), light)
    mask = eroded
    if np.count_nonzero(eroded) * crop.voxel_volume <= largest:
        reach = p.dilation if p.dilation is not None else (p.erosion or light) + 3.0 * sigma
        others = neighbours[parts.labels] & (depth > _LIGHT[0])
        region = Region(
            sharp, smooth, inside, level, eroded, others, apex, mean, deviation, width_of(p, deviation), dark, reach, h
        )
        mask = _regrown(region, p)
    return Segmentation(
        mask=crop.with_array(mask),
        mean=mean,
        deviation=deviation,
        wall=0.5 * (mean + dark),
        erosion=float(erosion),
        volume=float(np.count_nonzero(mask)) * crop.voxel_volume,
        at_edge=False,
        smoothing=sigma,
        clarity=_clarity(smooth, mask, level, _CLEAR * deviation, h),
    )


def _clarity(smooth: Singles, mask: Mask, level: Singles, contrast: float, h: float) -> float:
    """Return the fraction of the mask's surroundings, 3 to 6 mm away, that differs clearly from the organ."""
    box = _box_around(mask, 8.0 / h)
    away = depth_of(~mask[box]) * h
    ring = (away > 3.0) & (away <= 6.0)
    return float(np.mean(np.abs(smooth[box] - level[box])[ring] > contrast)) if ring.any() else 0.0


def _regrown(region: Region, p: SegmentationParameters) -> Mask:
    """Return the region after the last three stages, front, reconstruction and dilation, with hollows closed."""
    box = _box_around(region.eroded, (region.reach + 8.0) / region.h)
    near = region.cropped(box)
    own = dilate(near, _reconstruct(_front(near, p.stop), near.eroded), p.stiffness, p.spur)
    labels, _ = ndimage.label(own)
    mask = np.zeros(region.eroded.shape, dtype=bool)
    mask[box] = _closed(labels == labels[near.apex], near, p.closing / near.h)
    return mask


def _parted(depth: NDArray[np.float64], p: SegmentationParameters) -> Parts:
    """Return the region's bodies: separated at their necks, or what an erosion by a given depth leaves, grown back."""
    if p.erosion is None:
        return part(depth, p.neck)
    markers, count = ndimage.label(depth > p.erosion)
    labels = watershed(-depth, markers, mask=depth > 0.0)
    return Parts(labels, np.bincount(labels.ravel(), minlength=count + 1), np.zeros(count + 1))


def _closed(mask: Mask, region: Region, radius: float) -> Mask:
    """Return the mask with its holes filled, and its hollows of under `radius` voxels where they hold no fat or gas."""
    if radius > 0.0:
        around = np.pad(mask, int(np.ceil(radius)) + 1)
        grown = depth_of(~around) <= radius
        kept = depth_of(grown) > radius
        inner = tuple(slice(int(np.ceil(radius)) + 1, -int(np.ceil(radius)) - 1) for _ in range(3))
        mask = mask | (kept[inner] & (region.sharp > region.wall) & ~region.others)
    return ndimage.binary_fill_holes(mask)


def _majority(mask: Mask, sigma: float) -> Mask:
    """Return what most of a voxel's surroundings say, sigma in voxels: noise would fray the region."""
    fraction = sitk.SmoothingRecursiveGaussian(sitk.GetImageFromArray(mask.astype(np.float32)), sigma)
    return np.asarray(sitk.GetArrayFromImage(fraction) > 0.5)


def _without_holes(mask: Mask, voxels: float) -> Mask:
    """Return the mask with enclosed gaps of up to `voxels` voxels filled."""
    gaps, _ = ndimage.label(~mask)
    small = np.bincount(gaps.ravel()) <= voxels
    small[0] = False
    return mask | small[gaps]


def _box_around(mask: Mask, margin: float) -> Box:
    """Return the mask's bounding box grown by `margin` voxels, clipped to the array."""
    box = ndimage.find_objects(mask.astype(np.uint8))[0]
    grow = int(np.ceil(margin))
    return tuple(slice(max(s.start - grow, 0), min(s.stop + grow, n)) for s, n in zip(box, mask.shape, strict=True))  # type: ignore[return-value]


def ball_at(shape: tuple[int, ...], centre: Index, radius: float) -> Mask:
    """Return the voxels of a ball.

    Parameters
    ----------
    shape : tuple[int, ...]
        Shape of the array.
    centre : Index, z, y, x
        Array index of the centre.
    radius : float, voxels
        Radius of the ball.

    Returns
    -------
    Mask, shape (nz, ny, nx)
        The voxels.
    """
    axes = np.ogrid[tuple(slice(0, n) for n in shape)]
    squared = sum((axis - c) ** 2 for axis, c in zip(axes, centre, strict=True))
    return np.asarray(squared <= radius**2)


def _dark_side(sharp: Singles, seed: Index, mean: float, deviation: float, h: float) -> float:
    """Return the intensity of what surrounds the organ: fat, or whatever is clearly darker than the organ."""
    near = sharp[ball_at(sharp.shape, seed, _NEIGHBOURHOOD / h)]
    fat = near[(near > _FAT[0]) & (near < _FAT[1])]
    if len(fat) > 0.005 * len(near):
        return float(np.median(fat))
    darker = near[near < mean - 6.0 * deviation]
    return float(np.median(darker)) if len(darker) else mean - 12.0 * deviation


def _deepest(depth: NDArray[np.float64], body: Mask) -> Index:
    return tuple(int(i) for i in np.unravel_index(int(np.argmax(np.where(body, depth, 0.0))), depth.shape))  # type: ignore[return-value]


def _ascend(depth: NDArray[np.float64], start: Index) -> Index:
    """Return the local maximum of depth by steepest ascent; steps of up to two voxels pass over noise."""
    at = start
    while True:
        window = tuple(slice(max(i - 2, 0), i + 3) for i in at)
        block = depth[window]
        best = np.unravel_index(int(block.argmax()), block.shape)
        if block[best] <= depth[at]:
            return at
        at = tuple(s.start + int(b) for s, b in zip(window, best, strict=True))  # type: ignore[assignment]


def _front(region: Region, stop: float) -> Mask:
    """Return the front of fast marching from the seed through the eroded region, faster where the intensity fits.

    It stops when the fraction `stop` of the region's voxels is reached: the rest is left to the reconstruction.
    """
    eroded, apex = region.eroded, region.apex
    speed = np.exp(-0.5 * ((region.smooth - region.mean) / region.deviation) ** 2) * eroded
    marching = sitk.FastMarchingImageFilter()
    marching.SetTrialPoints([[int(i) for i in apex[::-1]]])
    marching.SetStoppingValue(1e6)
    arrival = sitk.GetArrayFromImage(marching.Execute(sitk.GetImageFromArray(speed.astype(np.float32))))
    reached = eroded & (arrival < 1e6)
    last = np.quantile(arrival[reached], stop) if reached.any() else 0.0
    front = reached & (arrival <= last)
    front[apex] = True
    return front


def _reconstruct(front: Mask, eroded: Mask) -> Mask:
    """Return the binary morphological reconstruction of the front under the eroded mask."""
    marker, under = (sitk.GetImageFromArray(m.astype(np.uint8)) for m in (front, eroded))
    return sitk.GetArrayFromImage(sitk.BinaryReconstructionByDilation(marker, under)) != 0
