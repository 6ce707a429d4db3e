"""Working grid of the segmentation: isotropic, along the patient's axes, at whole multiples of its spacing.

It depends on where the anatomy lies, not on the order or the direction of the file's axes: the same
patient saved sideways, upside down or obliquely gets the same grid.
"""

from __future__ import annotations

import numpy as np
import SimpleITK as sitk
from numpy.typing import ArrayLike

from tissue_sim.array_types import Floats, Mask
from tissue_sim.organ.imaging.image import Volume, from_sitk

_FINEST, _COARSEST = 1.0, 1.5  # mm


def default_spacing(ct: Volume) -> float:
    """Return the spacing of the working grid for an image: half of its coarsest, 1 to 1.5 mm.

    Parameters
    ----------
    ct : Volume
        The image.

    Returns
    -------
    float, mm
        The spacing.
    """
    return float(np.clip(ct.spacing.max() / 2.0, _FINEST, _COARSEST))


def resample(ct: Volume, box: ArrayLike, spacing: float) -> Volume:
    """Return the part of an image around a box on the working grid.

    Coarser grids take means over the voxels that they skip. Blank voxels of an oblique image take the value of the
    nearest voxel.

    Parameters
    ----------
    ct : Volume
        The image.
    box : ArrayLike, shape (2, 3), mm
        Lower and upper corner.
    spacing : float, mm
        Spacing of the grid.
    """
    corners = _corners(np.asarray(box, dtype=np.float64))
    index = ct.to_index(corners)
    part = ct.crop(
        (np.floor(index.min(axis=0)).astype(int) - 1).tolist(), (np.ceil(index.max(axis=0)).astype(int) + 1).tolist()
    )
    reach = part.to_points(_corners(np.array([[0, 0, 0], np.array(part.size) - 1], dtype=np.float64)))
    lower = np.maximum(corners.min(axis=0), reach.min(axis=0))
    upper = np.minimum(corners.max(axis=0), reach.max(axis=0))
    first = np.ceil(lower / spacing - 1e-6)
    size = np.maximum(np.floor(upper / spacing + 1e-6) - first + 1, 2).astype(int)
    image = part.to_sitk()
    skipped = np.maximum(np.floor(spacing / part.spacing + 1e-6), 1).astype(int)
    if np.any(skipped > 1):
        image = sitk.BinShrink(image, np.minimum(skipped, part.size).tolist())
    there = sitk.Resample(
        image,
        size.tolist(),
        sitk.Transform(),
        sitk.sitkLinear,
        (first * spacing).tolist(),
        [spacing] * 3,
        np.eye(3).ravel().tolist(),
        0.0,
        sitk.sitkFloat32,
        True,
    )
    return from_sitk(there, ct.name)


def within(ct: Volume, crop: Volume, margin: float = 0.0) -> Mask:
    """Return which voxels of a working grid lie in the image.

    Parameters
    ----------
    ct : Volume
        The image.
    crop : Volume
        Image on the working grid.
    margin : float, mm, optional
        Least distance from the image's outer faces.

    Returns
    -------
    Mask, shape (nz, ny, nx)
        The voxels.
    """
    nx, ny, nz = crop.size
    matrix = np.linalg.inv(ct.direction) / ct.spacing[:, None]
    start = ct.to_index(crop.origin)
    steps = matrix @ crop.direction * crop.spacing
    inside = np.ones(crop.array.shape, dtype=bool)
    for axis in range(3):
        x, y, z = (steps[axis, k] * np.arange(n) for k, n in enumerate((nx, ny, nz)))
        at = start[axis] + z[:, None, None] + y[None, :, None] + x[None, None, :]
        clear = margin / ct.spacing[axis] - 0.5 - 1e-6
        inside &= (at >= clear) & (at <= ct.size[axis] - 1 - clear)
    return inside


def _corners(box: Floats) -> Floats:
    return np.array([[box[i, 0], box[j, 1], box[k, 2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
