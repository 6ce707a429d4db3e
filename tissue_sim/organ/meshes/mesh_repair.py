"""Repairs of triangle surfaces: coinciding points, seams, duplicated triangles, winding, small holes."""

from __future__ import annotations

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from tissue_sim.array_types import Floats, Longs
from tissue_sim.organ.edges import directed_edges

WIDEST_HOLE = 0.1  # of the longest side: wider ones are refused
_SAME = 1e-6  # of the longest side: rim points nearer than that are one
_SEAM = 1e-3  # of the longest side: gaps between rims up to that are seams
_SEAM_EDGE = 0.25  # of the rim's median edge, the other bound of a seam


def longest_side(positions: Floats) -> float:
    """Return the longest side of the points' bounding box.

    Parameters
    ----------
    positions : Floats, shape (n, 3)
        Points of the surface.

    Returns
    -------
    float
        Length, in the unit of the points.
    """
    return float(np.ptp(positions, axis=0).max()) if len(positions) else 0.0


def once_used_edges(triangles: Longs) -> Longs:
    """Return the directed edges whose undirected edge belongs to one triangle only.

    Parameters
    ----------
    triangles : Longs, shape (t, 3)
        Corner indices, counter-clockwise seen from outside.

    Returns
    -------
    Longs, shape (k, 2)
        Point indices.
    """
    edges, _, count = _edges(triangles)
    return edges[count == 1]


def crowded_edges(triangles: Longs) -> int:
    """Return the number of edges with more than two triangles.

    Parameters
    ----------
    triangles : Longs, shape (t, 3)
        Corner indices, counter-clockwise seen from outside.
    """
    _, keys, count = _edges(triangles)
    return len(np.unique(keys[count > 2]))


def _edges(triangles: Longs) -> tuple[Longs, Longs, Longs]:
    """Return all directed edges (k, 2), a key (k,) that opposite edges share, and how many triangles use each."""
    directed = directed_edges(triangles)
    n = int(triangles.max()) + 1 if len(triangles) else 1
    keys = directed.min(axis=1) * n + directed.max(axis=1)
    _, inverse, count = np.unique(keys, return_inverse=True, return_counts=True)
    return directed, keys, count[inverse]


def close_seams(positions: Floats, triangles: Longs, across: bool) -> tuple[Longs, tuple[str, ...]]:
    """Merge coinciding points where the surface is open.

    A closed surface keeps every point. Triangles that lose a corner are dropped.

    Parameters
    ----------
    positions : Floats, shape (n, 3)
        Points of the surface.
    triangles : Longs, shape (t, 3)
        Corner indices, counter-clockwise seen from outside.
    across : bool
        Whether rim points are also merged across narrow seams.

    Returns
    -------
    tuple[Longs, tuple[str, ...]]
        The triangles, and lines that describe what was done.
    """
    repairs: list[str] = []
    triangles = triangles[_three_corners(triangles)]
    if not len(once_used_edges(triangles)):
        return triangles, ()
    size = longest_side(positions)
    merged, triangles = _merge_equal(positions, triangles)
    rim = once_used_edges(triangles)
    if len(rim):
        more, triangles = _merge(positions, triangles, np.unique(rim), _SAME * size)
        merged += more
        rim = once_used_edges(triangles)
    if merged:
        repairs.append(f"merged {merged} coinciding points")
    if across and len(rim):
        length = np.linalg.norm(positions[rim[:, 0]] - positions[rim[:, 1]], axis=1)
        reach = min(_SEAM * size, _SEAM_EDGE * float(np.median(length)))
        merged, triangles = _merge(positions, triangles, np.unique(rim), reach)
        if merged:
            repairs.append(f"joined {merged} rim points across seams of up to {reach / size * 100.0:.2g} % of the size")
    return triangles, tuple(repairs)


def _three_corners(triangles: Longs) -> NDArray[np.bool_]:
    a, b, c = triangles.T
    return (a != b) & (b != c) & (c != a)


def _merge_equal(positions: Floats, triangles: Longs) -> tuple[int, Longs]:
    """Return how many points fall out of use, and triangles that use the first of all points of equal coordinates."""
    before = len(np.unique(triangles))
    order = np.lexsort((np.arange(len(positions)), *positions.T))
    fresh = np.ones(len(positions), dtype=bool)
    fresh[1:] = np.any(positions[order[1:]] != positions[order[:-1]], axis=1)
    stands_for = np.empty(len(positions), dtype=np.int64)
    stands_for[order] = order[np.maximum.accumulate(np.where(fresh, np.arange(len(positions)), 0))]
    triangles = stands_for[triangles]
    triangles = triangles[_three_corners(triangles)]
    return before - len(np.unique(triangles)), triangles


def _merge(positions: Floats, triangles: Longs, among: Longs, reach: float) -> tuple[int, Longs]:
    """Return how many points fall out of use, and triangles that use the first of all points within `reach`."""
    pairs = cKDTree(positions[among]).query_pairs(reach, output_type="ndarray")
    if not len(pairs):
        return 0, triangles
    before = len(np.unique(triangles))
    n = len(among)
    links = coo_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(n, n))
    _, label = connected_components(links, directed=False)
    _, first = np.unique(label, return_index=True)
    stands_for = np.arange(len(positions))
    stands_for[among] = among[first[label]]
    triangles = stands_for[triangles]
    triangles = triangles[_three_corners(triangles)]
    return before - len(np.unique(triangles)), triangles


def without_doubles(triangles: Longs) -> tuple[Longs, int]:
    """Return each triangle once, whatever its winding.

    Parameters
    ----------
    triangles : Longs, shape (t, 3)
        Corner indices, counter-clockwise seen from outside.

    Returns
    -------
    tuple[Longs, int]
        The triangles, and how many were left out.
    """
    corners = np.sort(triangles, axis=1)
    order = np.lexsort((np.arange(len(corners)), *corners.T[::-1]))
    fresh = np.ones(len(corners), dtype=bool)
    fresh[1:] = np.any(corners[order[1:]] != corners[order[:-1]], axis=1)
    return triangles[np.sort(order[fresh])], int(np.count_nonzero(~fresh))


def wound_alike(positions: Floats, triangles: Longs) -> Longs | None:
    """Return the triangles with one winding in each part (trimesh.repair.fix_winding).

    Parameters
    ----------
    positions : Floats, shape (n, 3)
        Points of the surface.
    triangles : Longs, shape (t, 3)
        Corner indices, counter-clockwise seen from outside.

    Returns
    -------
    Longs | None, shape (t, 3)
        The triangles; None where no winding is consistent.
    """
    mesh = trimesh.Trimesh(positions, triangles, process=False)
    if mesh.is_winding_consistent:
        return triangles
    trimesh.repair.fix_winding(mesh)
    found = np.array(mesh.faces, dtype=np.int64)
    directed, _, count = _edges(found)
    twice = directed[count == 2]
    kept = np.unique(twice[:, 0] * (int(found.max()) + 1) + twice[:, 1])
    return found if len(kept) == len(twice) else None


def components(triangles: Longs) -> list[Longs]:
    """Return the parts that are connected by edges of two triangles, in order of their first triangle.

    Parameters
    ----------
    triangles : Longs, shape (t, 3)
        Corner indices, counter-clockwise seen from outside.

    Returns
    -------
    list[Longs]
        Triangle indices of each part.
    """
    mesh = trimesh.Trimesh(np.zeros((int(triangles.max()) + 1, 3)), triangles, process=False)
    label = trimesh.graph.connected_component_labels(mesh.face_adjacency, node_count=len(triangles))
    order = np.argsort(label, kind="stable")
    parts = np.split(order, np.flatnonzero(np.diff(label[order])) + 1)
    return sorted(parts, key=lambda part: int(part[0]))
