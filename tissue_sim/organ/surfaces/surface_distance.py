"""Exact distances from points to a triangle surface, over a grid of cells that list their triangles."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tissue_sim.array_types import Floats, Ints, Longs
from tissue_sim.jit import kernel

_MOST_CELLS = 4e6


def distance_to_surface(points: Floats, positions: Floats, triangles: Ints) -> Floats:
    """Return the exact distance from points to the nearest point of a surface.

    The exact distance to the nearest point of the nearest triangle (Ericson, Real-Time Collision Detection, 5.1.5).

    Parameters
    ----------
    points : Floats, shape (m, 3)
        Points.
    positions : Floats, shape (n, 3)
        Points of the surface.
    triangles : Ints, shape (t, 3)
        Corner indices, counter-clockwise seen from outside.

    Returns
    -------
    Floats, shape (m,)
        Distance, in the unit of the positions.

    References
    ----------
    Ericson: Real-Time Collision Detection, section 5.1.5.
    """
    corner = positions[triangles]
    return _nearest(np.ascontiguousarray(points, dtype=np.float64), corner, listed_in_cells(corner))


class Cells(NamedTuple):
    """A grid over triangles, and the triangles whose box touches each cell."""

    low: Floats  # (3,) its low corner
    cell: float  # the edge of a cell
    shape: Longs  # (3,) how many cells
    start: Longs  # (cells + 1,) where the triangles of each cell start
    member: Longs  # the triangles, cell by cell


def listed_in_cells(corner: Floats) -> Cells:
    """Return the grid of triangles, corners (t, 3, 3); its cells are as large as a usual one of them."""
    grid = _grid(corner)
    return Cells(*grid, *_cells(corner, *grid))


def _grid(corner: Floats) -> tuple[Floats, float, NDArray[np.int64]]:
    """Return a grid over triangles.

    Parameters
    ----------
    corner : Floats, shape (t, 3, 3)
        Corners of the triangles.

    Returns
    -------
    tuple[Floats, float, NDArray[np.int64]]
        Low corner of the grid, edge of its cells (that of a typical triangle), and their number along each axis.
    """
    low, high = corner.min(axis=(0, 1)), corner.max(axis=(0, 1))
    size = float((corner.max(axis=1) - corner.min(axis=1)).max(axis=1).mean())
    cell = max(size, float(np.cbrt(np.prod(np.maximum(high - low, size)) / _MOST_CELLS)))
    return low, cell, np.floor((high - low) / cell).astype(np.int64) + 1


@kernel
def _cells(corner, low, cell, shape):  # type: ignore[no-untyped-def]
    """Return the triangles whose box touches each cell, as start (cells + 1,) and member."""
    count = np.zeros(shape[0] * shape[1] * shape[2] + 1, dtype=np.int64)
    for fill in range(2):
        if fill == 1:
            start = np.cumsum(count)
            member = np.empty(start[-1], dtype=np.int32)
            at = start[:-1].copy()
        for t in range(corner.shape[0]):
            i0, i1 = _span(corner, t, 0, low, cell, shape)
            j0, j1 = _span(corner, t, 1, low, cell, shape)
            k0, k1 = _span(corner, t, 2, low, cell, shape)
            for k in range(k0, k1 + 1):
                for j in range(j0, j1 + 1):
                    for i in range(i0, i1 + 1):
                        c = (k * shape[1] + j) * shape[0] + i
                        if fill == 0:
                            count[c + 1] += 1
                        else:
                            member[at[c]] = t
                            at[c] += 1
    return start, member


@kernel
def _span(corner, t, axis, low, cell, shape):  # type: ignore[no-untyped-def]
    a, b, c = corner[t, 0, axis], corner[t, 1, axis], corner[t, 2, axis]
    first = int((min(a, b, c) - low[axis]) / cell)
    last = int((max(a, b, c) - low[axis]) / cell)
    return min(max(first, 0), shape[axis] - 1), min(max(last, 0), shape[axis] - 1)


@kernel
def _nearest(points, corner, cells):  # type: ignore[no-untyped-def]
    low, cell, shape, start, member = cells
    found = np.empty(points.shape[0])
    middle, radius = _balls(corner)
    at = np.empty(3, dtype=np.int64)
    for m in range(points.shape[0]):
        p = points[m]
        out = 0.0
        for axis in range(3):
            at[axis] = min(max(int(np.floor((p[axis] - low[axis]) / cell)), 0), shape[axis] - 1)
            beyond = max(low[axis] - p[axis], p[axis] - low[axis] - cell * shape[axis], 0.0)
            out += beyond * beyond
        best = np.inf  # squared
        reach = np.inf
        ring = 0
        while ring <= max(shape[0], shape[1], shape[2]):
            # Cells of this ring lie at least (ring - 1) cells from the point's own cell.
            nearest = max(ring - 1, 0) * cell
            if best <= max(nearest * nearest, out):
                break
            for k in range(max(at[2] - ring, 0), min(at[2] + ring, shape[2] - 1) + 1):
                for j in range(max(at[1] - ring, 0), min(at[1] + ring, shape[1] - 1) + 1):
                    edge = abs(k - at[2]) == ring or abs(j - at[1]) == ring
                    step = 1 if edge or ring == 0 else 2 * ring
                    for i in range(at[0] - ring, at[0] + ring + 1, step):
                        if i < 0 or i >= shape[0]:
                            continue
                        c = (k * shape[1] + j) * shape[0] + i
                        for q in range(start[c], start[c + 1]):
                            t = member[q]
                            x, y, z = p[0] - middle[t, 0], p[1] - middle[t, 1], p[2] - middle[t, 2]
                            if x * x + y * y + z * z >= (reach + radius[t]) ** 2:
                                continue
                            squared = _squared(p, corner[t, 0], corner[t, 1], corner[t, 2])
                            if squared < best:
                                best = squared
                                reach = np.sqrt(best)
            ring += 1
        found[m] = np.sqrt(best)
    return found


@kernel
def _balls(corner):  # type: ignore[no-untyped-def]
    """Return centre (t, 3) and radius (t,) of a ball around each triangle."""
    middle = np.empty((corner.shape[0], 3))
    radius = np.empty(corner.shape[0])
    for t in range(corner.shape[0]):
        largest = 0.0
        for m in range(3):
            middle[t, m] = (corner[t, 0, m] + corner[t, 1, m] + corner[t, 2, m]) / 3.0
        for k in range(3):
            squared = 0.0
            for m in range(3):
                squared += (corner[t, k, m] - middle[t, m]) ** 2
            largest = max(largest, squared)
        radius[t] = np.sqrt(largest)
    return middle, radius


@kernel
def _dot(u, v):  # type: ignore[no-untyped-def]
    return u[0] * v[0] + u[1] * v[1] + u[2] * v[2]


@kernel
def _squared(p, a, b, c):  # type: ignore[no-untyped-def]
    """Return the squared distance from p to the triangle a, b, c, by the region of the plane that p falls into."""
    ab = (b[0] - a[0], b[1] - a[1], b[2] - a[2])
    ac = (c[0] - a[0], c[1] - a[1], c[2] - a[2])
    ap = (p[0] - a[0], p[1] - a[1], p[2] - a[2])
    d1, d2 = _dot(ab, ap), _dot(ac, ap)
    v, w = 0.0, 0.0
    bp = (p[0] - b[0], p[1] - b[1], p[2] - b[2])
    d3, d4 = _dot(ab, bp), _dot(ac, bp)
    cp = (p[0] - c[0], p[1] - c[1], p[2] - c[2])
    d5, d6 = _dot(ab, cp), _dot(ac, cp)
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    if d1 <= 0.0 and d2 <= 0.0:
        v, w = 0.0, 0.0
    elif d3 >= 0.0 and d4 <= d3:
        v, w = 1.0, 0.0
    elif d6 >= 0.0 and d5 <= d6:
        v, w = 0.0, 1.0
    elif vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        v, w = d1 / (d1 - d3), 0.0
    elif vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        v, w = 0.0, d2 / (d2 - d6)
    elif va <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0:
        w = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        v = 1.0 - w
    else:
        total = va + vb + vc
        v, w = vb / total, vc / total
    x = ap[0] - v * ab[0] - w * ac[0]
    y = ap[1] - v * ab[1] - w * ac[1]
    z = ap[2] - v * ab[2] - w * ac[2]
    return x * x + y * y + z * z
