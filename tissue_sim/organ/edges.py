"""Edges of a triangle surface."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def directed_edges[Index: np.integer](triangles: NDArray[Index]) -> NDArray[Index]:
    """Return the edges of triangles in the direction in which each runs along them.

    Parameters
    ----------
    triangles
        (t, 3), corner indices.

    Returns
    -------
    NDArray[Index]
        (3 t, 2): all first edges, then all second ones, then all third ones.
    """
    return np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
