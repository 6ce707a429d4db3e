"""Voxels that a closed triangle surface encloses."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tissue_sim.array_types import Floats, Ints
from tissue_sim.jit import kernel


@kernel
def enclosed(points: Floats, triangles: Ints, size: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return the voxels whose centre the surface winds around, by signed crossings along z.

    Parameters
    ----------
    points : Floats, shape (n, 3), voxels
        Points in order x, y, z; voxel centres are at whole numbers. Points and edges should not lie exactly on columns
        of centres.
    triangles : Ints, shape (t, 3)
        Corner indices, outward.
    size : NDArray[np.int64], shape (3,)
        Number of voxels along x, y, z.

    Returns
    -------
    NDArray[np.bool_], shape (nz, ny, nx)
        The enclosed voxels.
    """
    nx, ny, nz = size[0], size[1], size[2]
    winding = np.zeros((nz + 1, ny, nx), dtype=np.int16)
    for t in range(triangles.shape[0]):
        a, b, c = points[triangles[t, 0]], points[triangles[t, 1]], points[triangles[t, 2]]
        area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        if area == 0.0:
            continue
        i0 = max(int(np.ceil(min(a[0], b[0], c[0]))), 0)
        i1 = min(int(np.floor(max(a[0], b[0], c[0]))), nx - 1)
        j0 = max(int(np.ceil(min(a[1], b[1], c[1]))), 0)
        j1 = min(int(np.floor(max(a[1], b[1], c[1]))), ny - 1)
        for j in range(j0, j1 + 1):
            for i in range(i0, i1 + 1):
                u = ((b[0] - i) * (c[1] - j) - (b[1] - j) * (c[0] - i)) / area
                v = ((c[0] - i) * (a[1] - j) - (c[1] - j) * (a[0] - i)) / area
                if u < 0.0 or v < 0.0 or u + v > 1.0:
                    continue
                z = u * a[2] + v * b[2] + (1.0 - u - v) * c[2]
                k = min(max(int(np.ceil(z)), 0), nz)
                winding[k, j, i] += -1 if area > 0.0 else 1
    solid = np.zeros((nz, ny, nx), dtype=np.bool_)
    for j in range(ny):
        for i in range(nx):
            total = 0
            for k in range(nz):
                total += winding[k, j, i]
                solid[k, j, i] = total > 0
    return solid


def off_grid(points: Floats) -> Floats:
    """Return the points shifted by a few thousandths of a voxel, off the columns of centres on which meshes often lie.

    Parameters
    ----------
    points : Floats, shape (n, 3), voxels
        Points.

    Returns
    -------
    Floats, shape (n, 3), voxels
        The shifted points.
    """
    return points + np.array([0.00137, 0.00731, 0.00353])
