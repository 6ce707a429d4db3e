"""Normals and areas of surfaces."""

from __future__ import annotations

import numpy as np

from tissue_sim.array_types import Floats, Ints, Longs


def surface_normals(positions: Floats, triangles: Ints | Longs) -> Floats:
    """Return the outward unit normals of surface nodes, each the area-weighted mean of its triangles' normals.

    Parameters
    ----------
    positions
        (n, 3), of the surface nodes.
    triangles
        (t, 3), counter-clockwise seen from outside.

    Returns
    -------
    Floats
        (n, 3), unit vectors; zero where there is no area.
    """
    a, b, c = (positions[triangles[:, corner]] for corner in range(3))
    part = np.repeat(np.cross(b - a, c - a), 3, axis=0)
    sums = [np.bincount(triangles.ravel(), weights=part[:, axis], minlength=len(positions)) for axis in range(3)]
    normal = np.stack(sums, axis=1)
    return normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), np.finfo(np.float64).tiny)


def triangle_area(positions: Floats, triangles: Ints | Longs) -> Floats:
    """Return the area of each triangle, (n_triangles,) m^2."""
    a, b, c = (positions[triangles[:, k]] for k in range(3))
    return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
