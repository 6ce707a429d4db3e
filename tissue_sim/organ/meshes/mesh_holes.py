"""Holes of a mesh: their rims, their size, and triangles that close them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tissue_sim.array_types import Floats, Longs
from tissue_sim.jit import kernel
from tissue_sim.organ.edges import directed_edges
from tissue_sim.organ.meshes.mesh_repair import once_used_edges

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
