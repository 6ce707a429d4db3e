"""Exact Euclidean distance on an isotropic grid."""

from __future__ import annotations

import numpy as np
import SimpleITK as sitk
from numpy.typing import NDArray

_FARTHEST = 1e6  # voxels: no background in sight


def depth_of(mask: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return the distance of every voxel of a mask to the nearest one outside it.

    It is computed by ITK in single precision, with the same result as SciPy's distance_transform_edt, but faster.

    Parameters
    ----------
    mask : NDArray[np.bool_], shape (nz, ny, nx)
        The mask.

    Returns
    -------
    NDArray[np.float64], shape (nz, ny, nx), voxels
        Distance; 0 outside, 1e6 where nothing lies outside.

    References
    ----------
    Maurer, Qi & Raghavan, IEEE Trans. PAMI 2003; 25: 265.
    """
    outside = sitk.GetImageFromArray((~mask).astype(np.uint8))
    signed = sitk.SignedMaurerDistanceMap(outside, insideIsPositive=False, squaredDistance=False, useImageSpacing=False)
    return np.clip(sitk.GetArrayFromImage(signed).astype(np.float64), 0.0, _FARTHEST)
