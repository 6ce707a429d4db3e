"""Size, shape and intensity of adult organs, and whether a segmentation can be such an organ.

The bounds are wide: small, large and moderately diseased organs are within them, while a region that leaked into a
neighbour or missed most of the organ is not. Sources of the usual sizes:
ICRP Publication 89 (2002), reference masses: liver 1800/1400 g (men/women), spleen 150/130 g, a kidney
155/138 g, heart with blood 840/620 g, prostate 17 g. By CT: kidney 177 +- 34 and 146 +- 28 mL, length
10.0 to 10.5 +- 0.9 cm (Kwon et al., Korean J Nephrol 2008; 27: 659); liver 1205 +- 258 mL, 594 to 2250 (Feng et al.,
World J Gastroenterol 2017; 23: 4968); spleen 195 +- 78 mL (Jasper, J Clin Diagn Res 2019; 13(8): TC01) and
46 mL upwards (Feng). Without contrast agent soft organs have 30 to 60 HU, less with fat or oedema; a fatty
liver has down to about -10, a bladder 0 to 20. With contrast agent: up to 250 HU, more where it is excreted.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import ConvexHull, QhullError
from scipy.spatial.distance import pdist

from tissue_sim.errors import UserError
from tissue_sim.organ.segmenting.separation import necks, part

if TYPE_CHECKING:
    from tissue_sim.organ.imaging.image import Volume

Range = tuple[float, float]

_COARSE = 2.0  # mm, fine enough to see a neck that matters
_NECK, _BODY = 0.5, 0.1  # fractions of the depth and of the volume


@dataclass(frozen=True)
class Anatomy:
    """Bounds of one adult organ.

    Attributes
    ----------
    name : str
        Name of the organ.
    volume : Range
        Range, mL.
    longest : Range
        Range of the greatest distance of two of its points, mm.
    intensity : Range
        Range of the mean, HU; the upper bound is with contrast agent.
    solidity : float
        Least fraction of the convex hull that the organ fills.
    """

    name: str
    volume: Range
    longest: Range
    intensity: Range
    solidity: float


ORGANS: dict[str, Anatomy] = {
    anatomy.name: anatomy
    for anatomy in (
        Anatomy("kidney", (60.0, 350.0), (75.0, 155.0), (0.0, 300.0), 0.55),
        Anatomy("liver", (550.0, 3500.0), (130.0, 340.0), (-20.0, 250.0), 0.45),
        Anatomy("spleen", (45.0, 900.0), (65.0, 220.0), (15.0, 250.0), 0.55),
        Anatomy("heart", (350.0, 1500.0), (90.0, 200.0), (10.0, 500.0), 0.70),
        Anatomy("bladder", (20.0, 1000.0), (30.0, 190.0), (-15.0, 400.0), 0.70),
        Anatomy("prostate", (8.0, 200.0), (22.0, 95.0), (10.0, 250.0), 0.70),
    )
}
ANY_NAME = "any"
ANY = Anatomy("organ", (10.0, 2500.0), (20.0, 340.0), (-30.0, 500.0), 0.42)  # smallest to largest of the above


@dataclass(frozen=True)
class Shape:
    """Measures of a mask: volume mL, longest extent mm, solidity (fraction of the convex hull)."""

    volume: float
    longest: float
    solidity: float


def anatomy_of(organ: str | None) -> Anatomy:
    """Return the bounds of an organ.

    Parameters
    ----------
    organ : str | None
        Name of the organ; None for the bounds of any organ.

    Raises
    ------
    UserError
        For an unknown organ; the message names the known ones.
    """
    if organ is None or organ == ANY_NAME:
        return ANY
    if organ not in ORGANS:
        raise UserError(f"--organ {organ} is unknown; choose one of {', '.join(ORGANS)}, {ANY_NAME}")
    return ORGANS[organ]


def measure_shape(mask: Volume) -> Shape:
    """Return the measures of a mask, from the centres of its outermost voxels, moved out by half a voxel.

    Parameters
    ----------
    mask : Volume
        The voxels of the organ.
    """
    surface = _outermost(mask.array)
    points = np.unique(mask.to_points(surface), axis=0)
    volume = float(np.count_nonzero(mask.array)) * mask.voxel_volume
    half = 0.5 * float(mask.spacing.max())
    try:
        hull = ConvexHull(points)
    except (QhullError, ValueError):
        return Shape(volume, float(np.ptp(points, axis=0).max()) if len(points) else 0.0, 1.0)
    around = hull.volume + hull.area * 0.5 * float(mask.spacing.mean())
    corners = points[hull.vertices]
    return Shape(volume, float(pdist(corners).max()) + 2.0 * half, min(volume * 1e3 / around, 1.0))


def _outermost(mask: NDArray[np.bool_]) -> NDArray[np.int_]:
    """Return the indices (n, 3), order x, y, z, of a mask's voxels with a neighbour outside."""
    inner = ndimage.binary_erosion(mask)
    return np.argwhere(mask & ~inner)[:, ::-1]


def misfits(mask: Volume, mean: float, organ: str | None) -> tuple[str, ...]:
    """Return the reasons why a mask can't be the organ; empty where there are none.

    Parameters
    ----------
    mask : Volume
        The voxels of the organ.
    mean : float, HU
        Mean intensity of the mask.
    organ : str | None
        Name of the organ; None for any organ.

    Returns
    -------
    tuple[str, ...]
        One reason per item.

    Raises
    ------
    UserError
        For an unknown organ.
    """
    bounds = anatomy_of(organ)
    shape = measure_shape(mask)
    found = []
    for what, value, unit, (low, high) in (
        ("a volume", shape.volume, "mL", bounds.volume),
        ("a longest extent", shape.longest, "mm", bounds.longest),
        ("a mean", mean, "HU", bounds.intensity),
    ):
        if not low <= value <= high:
            found.append(
                f"{what} of {value:.0f} {unit} (at {'most' if value > high else 'least'}"
                f" {high if value > high else low:.0f})"
            )
    if shape.solidity < bounds.solidity:
        found.append(f"{shape.solidity:.2f} of its convex hull filled (at least {bounds.solidity:g})")
    neck = narrowest(mask)
    if neck > 0.0:
        found.append(f"two bodies that are connected by a neck {2.0 * neck:.0f} mm wide")
    return tuple(found)


def narrowest(mask: Volume) -> float:
    """Return the half-width, mm, of the widest neck that joins a second body to the main one; 0 for one body.

    A neck counts if it is under half the depth of the smaller body, a body if it has at least a tenth of the whole.
    """
    every = max(int(_COARSE / float(mask.spacing.min())), 1)
    array = np.pad(mask.array[::every, ::every, ::every], 1)
    depth = ndimage.distance_transform_edt(array, sampling=mask.spacing[::-1] * every)
    parts = part(depth, _NECK)
    if len(parts.volume) < 3:
        return 0.0
    main = 1 + int(np.argmax(parts.volume[1:]))
    large = parts.volume > _BODY * parts.volume[1:].sum()
    large[[0, main]] = False
    return float(necks(parts, depth, main)[large].max(initial=0.0))
