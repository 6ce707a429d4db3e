"""The stages of the segmentation on one grid, and what can be tuned in them; segmentation.py runs them.

Threshold, erosion until the organ is separate, fast marching, reconstruction, dilation (Zhang, Gu et al. 2006,
section 2). Erosion and dilation by a ball are thresholds of the exact Euclidean distance, so depths are
millimetres on any grid.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
import SimpleITK as sitk
from numpy.typing import NDArray
from scipy import ndimage
from skimage.segmentation import watershed

from tissue_sim.array_types import Mask, Singles
from tissue_sim.errors import UserError
from tissue_sim.organ.imaging.image import Volume
from tissue_sim.organ.segmenting.depth import depth_of
from tissue_sim.organ.segmenting.dilation import dilate, local_mean
from tissue_sim.organ.segmenting.separation import Parts, necks, part

Index = tuple[int, int, int]

SMOOTHINGS = (2.5, 3.0)  # mm, tried until the tissue at the seed is calm
WINDOWS = (2.5, 3.3, 4.3, 5.5)  # half-widths tried, in deviations
_FAT = (-160.0, -40.0)  # HU
_NEIGHBOURHOOD = 60.0  # mm around the seed in which the dark side (fat) is looked for
_LIGHT_SHARE, _LIGHT = 0.15, (1.5, 3.0)  # of the depth; mm: least erosion, takes blurred rims and sheets off
_LOBE = 0.03  # volume share from which a neighbouring body counts
_MAJORITY = 1.5  # mm
_HOLE = 0.15  # mL, up to which a gap in the thresholded tissue is noise
_DRIFT, _DRIFT_WIDTH = 10.0, 20.0  # HU, mm: how far the organ's intensity may wander, and over what distance
_REFINEMENTS = 4
_CLEAR = 3.0  # deviations from the organ from which its surroundings are clearly something else


def _option(default: Any, unit: str, text: str, bounds: tuple[float, float]) -> Any:
    return field(default=default, metadata={"unit": unit, "help": text, "range": bounds})


@dataclass(frozen=True)
class SegmentationParameters:
    """What can be tuned at every stage. None: worked out from the image.

    Every field's metadata hold its unit, a line of help and its range; a value out of range raises UserError
    that names the field as the command line has it.
    """

    smoothing: float | None = _option(
        None, "mm", "standard deviation of the Gaussian before intensities are compared; by default 2.5 or 3,"
        " until the tissue at the seed is calm", (0.1, 10.0),
    )  # fmt: skip
    wall_smoothing: float = _option(0.6, "mm", "the same before the wall is located", (0.1, 10.0))
    window: float | None = _option(
        None, "SD", "half-width of the intensity window, in deviations of the tissue at the seed; by default the one"
        " of several whose region has the clearest wall and shape", (0.5, 50.0),
    )  # fmt: skip
    least_deviation: float = _option(3.0, "HU", "a calm tissue's deviation is taken as no less", (0.1, 100.0))
    seed_radius: float = _option(7.0, "mm", "radius of the ball whose intensities start the window", (1.0, 50.0))
    erosion: float | None = _option(None, "mm", "erosion depth; by default until the organ is separate", (0.01, 100.0))
    neck: float = _option(0.6, "share", "a neck under this share of the smaller lobe's depth parts organs", (0.0, 1.0))
    stop: float = _option(0.5, "share", "of the eroded region, after which the front stops", (0.01, 1.0))
    dilation: float | None = _option(
        None,
        "mm",
        "how far the eroded organ may dilate back; by default the erosion and three smoothings",
        (0.0, 100.0),
    )
    stiffness: float = _option(0.5, "share", "weight of the image against a small wall while it dilates", (0.01, 100.0))
    spur: float = _option(3.0, "mm", "vessels and spurs of less than this radius are left out", (0.0, 50.0))
    closing: float = _option(6.0, "mm", "hollows of less than this radius are filled, except with fat", (0.0, 50.0))
    grid: float | None = _option(
        None, "mm", "spacing of the working grid; by default half the image's coarsest, 1 to 1.5", (0.3, 10.0)
    )

    def __post_init__(self) -> None:
        for entry in fields(self):
            value, (low, high) = getattr(self, entry.name), entry.metadata["range"]
            if value is not None and not low <= value <= high:
                name = "--" + entry.name.replace("_", "-")
                raise UserError(f"{name} {value:g} must lie within {low:g}..{high:g} {entry.metadata['unit']}")


@dataclass(frozen=True, eq=False)
class Segmentation:
    """One organ: its mask on the working grid, and how it was found.

    mask: bool Volume. mean, deviation HU of the organ; wall HU: half-way to the fat; erosion mm;
    volume mL; at_edge: the organ reaches the image's border, so part of it is missing; smoothing mm: as used;
    clarity: share of its surroundings that differ clearly from it; warnings: what speaks against the organ that was
    asked for.
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

    def figures(self) -> dict[str, Any]:
        """What goes into the provenance."""
        names = ("mean", "deviation", "wall", "erosion", "volume", "smoothing")
        figures = {key: round(getattr(self, key), 3) for key in names}
        more = {"at_edge": self.at_edge, "grid_mm": float(self.mask.spacing[0]), "warnings": list(self.warnings)}
        return figures | more


def point_text(point: NDArray[np.float64]) -> str:
    """A point (3,) mm as the messages show it."""
    return ",".join(f"{value:g}" for value in np.round(point, 1))


def gaussian(volume: Volume, sigma: float) -> Singles:
    """The image (nz, ny, nx), HU, smoothed by a Gaussian of deviation `sigma` mm."""
    return sitk.GetArrayFromImage(sitk.SmoothingRecursiveGaussian(volume.to_sitk(), sigma))


def voxel_at(crop: Volume, point: NDArray[np.float64]) -> Index:
    """Array index (z, y, x) of the voxel nearest to a point, within the crop."""
    i, j, k = np.clip(np.round(crop.to_index(point)).astype(int), 0, np.array(crop.size) - 1)
    return int(k), int(j), int(i)


def smooth_for(crop: Volume, p: SegmentationParameters) -> tuple[Singles, Singles]:
    """The crop (nz, ny, nx), HU, smoothed to compare intensities, and to locate the wall."""
    return gaussian(crop, float(p.smoothing or SMOOTHINGS[0])), gaussian(crop, p.wall_smoothing)


def segment_crop(
    crop: Volume,
    inside: Mask,
    point: NDArray[np.float64],
    p: SegmentationParameters,
    mean: float,
    deviation: float,
    smoothed: tuple[Singles, Singles] | None = None,
    largest: float = np.inf,
) -> Segmentation:
    """All stages on one isotropic crop, from a first mean; the deviation, both HU, is the seed's.

    smoothed: what `smooth_for` gives, when several windows are tried on one crop. largest:
    mL, a region that is more when eroded has leaked and isn't dilated.

    It may fall to the region's, but doesn't grow with it: a small leak would widen the window and let in more.
    """
    h = float(crop.spacing[0])
    sigma = float(p.smoothing or SMOOTHINGS[0])
    smooth, sharp = smoothed or smooth_for(crop, p)
    seed = voxel_at(crop, point)
    dark = _dark_side(sharp, seed, mean, deviation, h)
    level: Singles = np.full(smooth.shape, mean, dtype=np.float32)
    for again in range(_REFINEMENTS):
        width = float(p.window or WINDOWS[1]) * deviation
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
        light = float(np.clip(_LIGHT_SHARE * depth[apex], *_LIGHT))
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
        mask = _regrown(
            smooth,
            sharp,
            level,
            depth,
            eroded,
            neighbours[parts.labels],
            inside,
            apex,
            p,
            mean=mean,
            deviation=deviation,
            dark=dark,
            reach=reach,
            h=h,
        )
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
    """Share of the mask's surroundings, 3 to 6 mm off, that differ clearly from the organ."""
    box = _box_around(mask, 8.0 / h)
    away = depth_of(~mask[box]) * h
    ring = (away > 3.0) & (away <= 6.0)
    return float(np.mean(np.abs(smooth[box] - level[box])[ring] > contrast)) if ring.any() else 0.0


def _regrown(
    smooth: Singles,
    sharp: Singles,
    level: Singles,
    depth: NDArray[np.float64],
    eroded: Mask,
    neighbours: Mask,
    inside: Mask,
    apex: Index,
    p: SegmentationParameters,
    *,
    mean: float,
    deviation: float,
    dark: float,
    reach: float,
    h: float,
) -> Mask:
    """The last three stages: front, reconstruction, dilation by up to `reach` mm; then hollows are closed."""
    box = _box_around(eroded, (reach + 8.0) / h)
    local: Index = tuple(i - s.start for i, s in zip(apex, box, strict=True))  # type: ignore[assignment]
    core = _reconstruct(_front(smooth[box], eroded[box], local, mean, deviation, p.stop), eroded[box])
    others = neighbours[box] & (depth[box] > _LIGHT[0])
    own = dilate(
        sharp[box], smooth[box], level[box], core, others, inside[box],
        mean=mean, width=float(p.window or WINDOWS[1]) * deviation, dark=dark, reach=reach, h=h,
        stiffness=p.stiffness, spur=p.spur,
    )  # fmt: skip
    labels, _ = ndimage.label(own)
    mask = np.zeros(depth.shape, dtype=bool)
    mask[box] = _closed(labels == labels[local], sharp[box], others, 0.5 * (mean + dark), p.closing / h)
    return mask


def _parted(depth: NDArray[np.float64], p: SegmentationParameters) -> Parts:
    """The region's bodies: parted at their necks, or what an erosion by a given depth leaves, grown back."""
    if p.erosion is None:
        return part(depth, p.neck)
    markers, count = ndimage.label(depth > p.erosion)
    labels = watershed(-depth, markers, mask=depth > 0.0)
    return Parts(labels, np.bincount(labels.ravel(), minlength=count + 1), np.zeros(count + 1))


def _closed(mask: Mask, sharp: Singles, others: Mask, wall: float, radius: float) -> Mask:
    """The mask with its holes filled, and its hollows of under `radius` voxels where they hold no fat or gas."""
    if radius > 0.0:
        around = np.pad(mask, int(np.ceil(radius)) + 1)
        grown = depth_of(~around) <= radius
        kept = depth_of(grown) > radius
        inner = tuple(slice(int(np.ceil(radius)) + 1, -int(np.ceil(radius)) - 1) for _ in range(3))
        mask = mask | (kept[inner] & (sharp > wall) & ~others)
    return ndimage.binary_fill_holes(mask)


def _majority(mask: Mask, sigma: float) -> Mask:
    """What most of a voxel's surroundings say, sigma in voxels: noise would fray the region."""
    share = sitk.SmoothingRecursiveGaussian(sitk.GetImageFromArray(mask.astype(np.float32)), sigma)
    return np.asarray(sitk.GetArrayFromImage(share) > 0.5)


def _without_holes(mask: Mask, voxels: float) -> Mask:
    """The mask with enclosed gaps of up to so many voxels filled."""
    gaps, _ = ndimage.label(~mask)
    small = np.bincount(gaps.ravel()) <= voxels
    small[0] = False
    return mask | small[gaps]


def _box_around(mask: Mask, margin: float) -> tuple[slice, slice, slice]:
    """The mask's bounding box grown by `margin` voxels, clipped to the array."""
    box = ndimage.find_objects(mask.astype(np.uint8))[0]
    grow = int(np.ceil(margin))
    return tuple(slice(max(s.start - grow, 0), min(s.stop + grow, n)) for s, n in zip(box, mask.shape, strict=True))  # type: ignore[return-value]


def ball_at(shape: tuple[int, ...], centre: Index, radius: float) -> Mask:
    """Ball of `radius` voxels around an array index (z, y, x)."""
    axes = np.ogrid[tuple(slice(0, n) for n in shape)]
    squared = sum((axis - c) ** 2 for axis, c in zip(axes, centre, strict=True))
    return np.asarray(squared <= radius**2)


def _dark_side(sharp: Singles, seed: Index, mean: float, deviation: float, h: float) -> float:
    """Intensity of what surrounds the organ: fat, or whatever is clearly darker than the organ."""
    near = sharp[ball_at(sharp.shape, seed, _NEIGHBOURHOOD / h)]
    fat = near[(near > _FAT[0]) & (near < _FAT[1])]
    if len(fat) > 0.005 * len(near):
        return float(np.median(fat))
    darker = near[near < mean - 6.0 * deviation]
    return float(np.median(darker)) if len(darker) else mean - 12.0 * deviation


def _deepest(depth: NDArray[np.float64], body: Mask) -> Index:
    return tuple(int(i) for i in np.unravel_index(int(np.argmax(np.where(body, depth, 0.0))), depth.shape))  # type: ignore[return-value]


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


def _front(smooth: Singles, eroded: Mask, apex: Index, mean: float, deviation: float, stop: float) -> Mask:
    """Fast marching from the seed through the eroded region, faster where the intensity fits.

    Stopped when the share `stop` of the region's voxels is reached: what is left is the reconstruction's.
    """
    speed = np.exp(-0.5 * ((smooth - mean) / deviation) ** 2) * eroded
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
    """Binary morphological reconstruction of the front under the eroded mask."""
    marker, under = (sitk.GetImageFromArray(m.astype(np.uint8)) for m in (front, eroded))
    return sitk.GetArrayFromImage(sitk.BinaryReconstructionByDilation(marker, under)) != 0
