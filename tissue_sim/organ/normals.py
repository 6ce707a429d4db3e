"""Normals of a closed surface."""

from __future__ import annotations

import numpy as np

from tissue_sim.array_types import Floats, Ints


def surface_normals(positions: Floats, triangles: Ints) -> Floats:
    """Return the outward unit normals of surface nodes, each the area-weighted mean of its triangles' normals.

    Parameters
    ----------
    positions
        (n, 3) m, of the surface nodes.
    triangles
        (t, 3), counter-clockwise seen from outside.

    Returns
    -------
    Floats
        (n, 3), unit vectors.
    """
    a, b, c = (positions[triangles[:, corner]] for corner in range(3))
    normal = np.zeros_like(positions)
    np.add.at(normal, triangles.ravel(), np.repeat(np.cross(b - a, c - a), 3, axis=0))
    return normal / np.linalg.norm(normal, axis=1, keepdims=True)
