"""Self-intersections of a triangle surface, and segments that run through it."""

from __future__ import annotations

import numpy as np

from tissue_sim.array_types import Floats, Ints
from tissue_sim.jit import kernel
from tissue_sim.organ.surfaces.remesh import normal_of
from tissue_sim.organ.surfaces.surface_distance import _dot, _span, listed_in_cells


def intersecting_pairs(positions: Floats, triangles: Ints) -> Ints:
    """Return the pairs of triangles of which an edge of one runs through the other, except where they are joined.

    Triangles with one common point are tested by the edges opposite to it; those with a common edge are not. Candidates
    share a cell of a grid and overlap in their boxes.

    Parameters
    ----------
    positions : Floats, shape (n, 3)
        Points of the surface.
    triangles : Ints, shape (t, 3)
        Corner indices, counter-clockwise seen from outside.

    Returns
    -------
    Ints, shape (k, 2)
        Triangle indices.

    References
    ----------
    Moeller & Trumbore 1997: Fast, minimum storage ray/triangle intersection.
    """
    corner = positions[triangles]
    return _pairs(corner, np.ascontiguousarray(triangles), listed_in_cells(corner))


@kernel
def is_crossed(start, end, corner):  # type: ignore[no-untyped-def]
    """Return whether the segment between two points (3,) runs through any triangle of (t, 3, 3)."""
    for t in range(corner.shape[0]):  # noqa: SIM110
        if _hits(start, end, corner[t]):
            return True
    return False


@kernel
def _pairs(corner, triangles, cells):  # type: ignore[no-untyped-def]
    low, cell, shape, start, member = cells
    faces = triangles.shape[0]
    found = np.empty((64, 2), dtype=np.int32)
    count = 0
    seen = np.full(faces, -1, dtype=np.int32)
    for t in range(faces):
        i0, i1 = _span(corner, t, 0, low, cell, shape)
        j0, j1 = _span(corner, t, 1, low, cell, shape)
        k0, k1 = _span(corner, t, 2, low, cell, shape)
        for k in range(k0, k1 + 1):
            for j in range(j0, j1 + 1):
                for i in range(i0, i1 + 1):
                    c = (k * shape[1] + j) * shape[0] + i
                    for m in range(start[c], start[c + 1]):
                        q = member[m]
                        if q <= t or seen[q] == t:
                            continue
                        seen[q] = t
                        if not _overlap(corner, t, q) or not _cross(corner, triangles, t, q):
                            continue
                        if count == found.shape[0]:
                            found = np.concatenate((found, np.empty_like(found)))
                        found[count, 0], found[count, 1] = t, q
                        count += 1
    return found[:count].copy()


@kernel
def _overlap(corner, t, q):  # type: ignore[no-untyped-def]
    """Return whether the boxes around two triangles touch."""
    for m in range(3):
        a = min(corner[t, 0, m], corner[t, 1, m], corner[t, 2, m])
        b = max(corner[t, 0, m], corner[t, 1, m], corner[t, 2, m])
        c = min(corner[q, 0, m], corner[q, 1, m], corner[q, 2, m])
        d = max(corner[q, 0, m], corner[q, 1, m], corner[q, 2, m])
        if a > d or c > b:
            return False
    return True


@kernel
def _cross(corner, triangles, t, q):  # type: ignore[no-untyped-def]
    common, in_t, in_q = 0, -1, -1
    for a in range(3):
        for b in range(3):
            if triangles[t, a] == triangles[q, b]:
                common += 1
                in_t, in_q = a, b
    if common > 1:
        return False
    for k in range(3):
        if (common == 0 or in_t == (k + 2) % 3) and _hits(corner[t, k], corner[t, (k + 1) % 3], corner[q]):
            return True
        if (common == 0 or in_q == (k + 2) % 3) and _hits(corner[q, k], corner[q, (k + 1) % 3], corner[t]):
            return True
    return False


@kernel
def _hits(start, end, triangle):  # type: ignore[no-untyped-def]
    """Return whether the segment start - end runs through the triangle (3, 3)."""
    a = triangle[0]
    u = (triangle[1, 0] - a[0], triangle[1, 1] - a[1], triangle[1, 2] - a[2])
    v = (triangle[2, 0] - a[0], triangle[2, 1] - a[1], triangle[2, 2] - a[2])
    d = (end[0] - start[0], end[1] - start[1], end[2] - start[2])
    nothing = (0.0, 0.0, 0.0)
    p = normal_of(nothing, d, v)
    det = _dot(u, p)
    if abs(det) <= 1e-18:
        return False
    s = (start[0] - a[0], start[1] - a[1], start[2] - a[2])
    q = normal_of(nothing, s, u)
    alpha, beta, t = _dot(s, p) / det, _dot(d, q) / det, _dot(v, q) / det
    return alpha >= 0.0 and beta >= 0.0 and alpha + beta <= 1.0 and t >= 0.0 and t <= 1.0
