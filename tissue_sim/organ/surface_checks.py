"""Checks of a closed surface, and the volume that it encloses."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from tissue_sim.array_types import Floats, Ints
from tissue_sim.errors import UserError
from tissue_sim.organ.edges import directed_edges


def signed_volume(positions: Floats, triangles: Ints) -> float:
    """Return the volume enclosed by a closed surface, positive when its triangles point outward.

    Parameters
    ----------
    positions : Floats, shape (n, 3), m
        Points.
    triangles : Ints, shape (t, 3)
        Corner indices, counter-clockwise seen from outside.

    Returns
    -------
    float, m^3
        The volume.
    """
    a, b, c = (positions[triangles[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0)


def check_surface(positions: Floats, triangles: Ints, name: str) -> None:
    """Raise UserError unless the triangles form one closed, consistently wound, outward surface.

    Every directed edge must occur once, with its opposite (closed and consistently wound); the
    signed volume must be positive (outward).

    Parameters
    ----------
    positions : Floats, shape (n, 3)
        Points.
    triangles : Ints, shape (t, 3)
        Corner indices, counter-clockwise seen from outside.
    name : str
        Name for messages.

    Raises
    ------
    UserError
        Where a directed edge doesn't occur exactly once together with its opposite, where points are unused, where the
        surface falls into pieces, and where its signed volume isn't positive.
    """
    directed = directed_edges(triangles).astype(np.int64)
    if len(directed) == 0:
        raise UserError(f"{name}: the surface has no triangles")
    n = len(positions)
    forward = np.sort(directed[:, 0] * n + directed[:, 1])
    backward = np.sort(directed[:, 1] * n + directed[:, 0])
    undirected = np.unique(np.sort(directed, axis=1), axis=0, return_counts=True)[1]
    open_edges = int(np.count_nonzero(undirected == 1))
    if open_edges:
        raise UserError(f"{name}: the surface is open ({open_edges} open edges); close its holes first")
    if not np.array_equal(forward, backward) or np.any(forward[1:] == forward[:-1]):
        raise UserError(f"{name}: the surface's triangles are wound inconsistently; make them all point outward")
    used = np.unique(triangles)
    if len(used) != n:
        raise UserError(f"{name}: {n - len(used)} surface points belong to no triangle; remove them")
    links = coo_array((np.ones(len(directed)), (directed[:, 0], directed[:, 1])), shape=(n, n))
    pieces = connected_components(links, directed=False, return_labels=False)
    if pieces > 1:
        raise UserError(f"{name}: the surface falls into {pieces} pieces; keep one of them")
    if signed_volume(positions, triangles) <= 0.0:
        raise UserError(f"{name}: the surface is inverted (negative volume); flip its triangles")
