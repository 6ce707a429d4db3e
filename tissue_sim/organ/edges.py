"""Edges of triangles, and edges and faces of tetrahedra."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

CELL_EDGES = tuple((a, b) for a in range(4) for b in range(a + 1, 4))  # of a tetrahedron, by its corners
CELL_FACES = np.array([(1, 2, 3), (0, 2, 3), (0, 1, 3), (0, 1, 2)])  # the face opposite to each corner


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


def cell_edges[Index: np.integer](cells: NDArray[Index]) -> NDArray[Index]:
    """Return the edges of tetrahedra.

    Parameters
    ----------
    cells
        (c, 4), corner indices.

    Returns
    -------
    NDArray[Index]
        (6 c, 2): all first edges, then all second ones, and so on, in the order of CELL_EDGES.
    """
    return np.concatenate([cells[:, list(edge)] for edge in CELL_EDGES])
