"""Repairs of triangle surfaces: coinciding points, seams, duplicated triangles, winding, small holes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from tissue_sim.array_types import Floats, Longs
from tissue_sim.jit import kernel
from tissue_sim.organ.edges import directed_edges

WIDEST_HOLE = 0.1  # of the longest side: wider ones are refused
_SAME = 1e-6  # of the longest side: rim points nearer than that are one
_SEAM = 1e-3  # of the longest side: gaps between rims up to that are seams
_SEAM_EDGE = 0.25  # of the rim's median edge, the other bound of a seam
_LONGEST_RIM = 1500  # points: the triangulation takes their cube


@dataclass(frozen=True, eq=False)
class Hole:
    """Hole of a surface.

    Attributes
    ----------
    rim : Longs, shape (k,)
        Point indices in the order that closes it.
    width : float
        Largest distance of two points of the rim.
    """

    rim: Longs
    width: float


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

    Returns
    -------
    int
        The number.
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


def holes(positions: Floats, triangles: Longs) -> list[Hole]:
    """Return the holes of a consistently wound surface, widest first.

    Parameters
    ----------
    positions : Floats, shape (n, 3)
        Points of the surface.
    triangles : Longs, shape (t, 3)
        Corner indices, counter-clockwise seen from outside.

    Returns
    -------
    list[Hole]
        The holes.
    """
    found = []
    for rim in _rims(once_used_edges(triangles)):
        points = positions[rim]
        width = max(float(np.linalg.norm(points - p, axis=1).max()) for p in points)
        found.append(Hole(rim, width))
    return sorted(found, key=lambda hole: -hole.width)


def _rims(edges: Longs) -> list[Longs]:
    """Return simple closed loops of the reversed edges; rims that touch in a point are separated there."""
    onward: dict[int, list[int]] = {}
    for a, b in edges.tolist():
        onward.setdefault(b, []).append(a)
    loops = []
    for start in sorted(onward):
        while onward[start]:
            path, place = [start], {start: 0}
            while onward.get(path[-1]):
                following = onward[path[-1]].pop()
                if following in place:
                    at = place[following]
                    loops.append(np.array(path[at:], dtype=np.int64))
                    for point in path[at + 1 :]:
                        del place[point]
                    path = path[: at + 1]
                else:
                    place[following] = len(path)
                    path.append(following)
    return [loop for loop in loops if len(loop) >= 3]


def fill(positions: Floats, triangles: Longs, gaps: Sequence[Hole]) -> Longs | None:
    """Return the triangles with the holes closed by the triangulation of least area, without new points.

    Dynamic programming over the rim; edges that the surface already has are not used again.

    Parameters
    ----------
    positions : Floats, shape (n, 3)
        Points of the surface.
    triangles : Longs, shape (t, 3)
        Corner indices, counter-clockwise seen from outside.
    gaps : Sequence[Hole]
        Its holes.

    Returns
    -------
    Longs | None, shape (t, 3)
        The triangles; None where a rim is too long or allows no such triangulation.

    References
    ----------
    Barequet & Sharir 1995: Filling gaps in the boundary of a polyhedron.
    """
    n = len(positions)
    patches = [triangles]
    for hole in gaps:
        if len(hole.rim) > _LONGEST_RIM:
            return None
        present = np.concatenate(patches)
        edges = np.sort(directed_edges(present), axis=1)
        keys = np.unique(edges[:, 0] * n + edges[:, 1])
        low = np.minimum(hole.rim[:, None], hole.rim[None, :])
        high = np.maximum(hole.rim[:, None], hole.rim[None, :])
        taken = np.isin(low * n + high, keys)
        patch = _least_area(np.ascontiguousarray(positions[hole.rim]), taken)
        if not len(patch):
            return None
        patches.append(hole.rim[patch])
    return np.concatenate(patches)


@kernel
def _least_area(points: Floats, taken: NDArray[np.bool_]) -> Longs:
    """Return the triangles (k - 2, 3) of least area of the polygon points (k, 3), without the chords `taken`."""
    k = points.shape[0]
    cost = np.full((k, k), np.inf)
    best = np.full((k, k), -1, dtype=np.int64)
    for i in range(k - 1):
        cost[i, i + 1] = 0.0
    for span in range(2, k):
        for i in range(k - span):
            j = i + span
            if taken[i, j] and span < k - 1:
                continue
            for m in range(i + 1, j):
                if cost[i, m] == np.inf or cost[m, j] == np.inf:
                    continue
                u, v = points[m] - points[i], points[j] - points[i]
                x = u[1] * v[2] - u[2] * v[1]
                y = u[2] * v[0] - u[0] * v[2]
                z = u[0] * v[1] - u[1] * v[0]
                total = cost[i, m] + cost[m, j] + 0.5 * np.sqrt(x * x + y * y + z * z)
                if total < cost[i, j]:
                    cost[i, j] = total
                    best[i, j] = m
    if best[0, k - 1] < 0:
        return np.empty((0, 3), dtype=np.int64)
    triangles = np.empty((k - 2, 3), dtype=np.int64)
    stack = np.empty((2 * k, 2), dtype=np.int64)
    stack[0, 0], stack[0, 1] = 0, k - 1
    waiting, made = 1, 0
    while waiting:
        waiting -= 1
        i, j = stack[waiting, 0], stack[waiting, 1]
        if j - i < 2:
            continue
        m = best[i, j]
        triangles[made, 0], triangles[made, 1], triangles[made, 2] = i, m, j
        made += 1
        stack[waiting, 0], stack[waiting, 1] = i, m
        stack[waiting + 1, 0], stack[waiting + 1, 1] = m, j
        waiting += 2
    return triangles


def capped_volume(positions: Floats, triangles: Longs, gaps: Sequence[Hole]) -> float:
    """Return the signed volume of a wound surface whose holes are capped by fans around their rims' centres.

    Parameters
    ----------
    positions : Floats, shape (n, 3)
        Points of the surface.
    triangles : Longs, shape (t, 3)
        Corner indices, counter-clockwise seen from outside.
    gaps : Sequence[Hole]
        Its holes.

    Returns
    -------
    float
        Volume, in the cube of the points' unit.
    """
    centre = positions[triangles[:, 0]].mean(axis=0)
    a, b, c = (positions[triangles[:, k]] - centre for k in range(3))
    total = float(np.einsum("ij,ij->", a, np.cross(b, c)))
    for hole in gaps:
        rim = positions[hole.rim] - centre
        total += float(np.einsum("ij,j->", np.cross(rim, np.roll(rim, -1, axis=0)), rim.mean(axis=0)))
    return total / 6.0


def area_of(positions: Floats, triangles: Longs) -> float:
    """Return the area of the triangles.

    Parameters
    ----------
    positions : Floats, shape (n, 3)
        Points of the surface.
    triangles : Longs, shape (t, 3)
        Corner indices, counter-clockwise seen from outside.

    Returns
    -------
    float
        Area, in the square of the points' unit.
    """
    a, b, c = (positions[triangles[:, k]] for k in range(3))
    return 0.5 * float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum())
