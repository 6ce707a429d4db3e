"""Exact Euclidean distance on an isotropic grid."""

from __future__ import annotations

import numpy as np
import SimpleITK as sitk
from numpy.typing import NDArray

_FARTHEST = 1e6  # voxels: no background in sight


def depth_of(mask: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Distance, voxels, of every voxel of `mask` (nz, ny, nx) to the nearest one outside it; 0 outside.

    Maurer, Qi & Raghavan, IEEE Trans. PAMI 2003; 25: 265, as ITK has it, in single precision; the same as SciPy's
    distance_transform_edt, but faster. 1e6 where nothing lies outside.
    """
    outside = sitk.GetImageFromArray((~mask).astype(np.uint8))
    signed = sitk.SignedMaurerDistanceMap(outside, insideIsPositive=False, squaredDistance=False, useImageSpacing=False)
    return np.clip(sitk.GetArrayFromImage(signed).astype(np.float64), 0.0, _FARTHEST)
