"""How long a surface's edges are at each point, and how thick the body is there."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from tissue_sim.array_types import Floats, Ints
from tissue_sim.organ.normals import surface_normals

Wanted = Callable[[Floats], Floats]  # edge lengths (n,) wanted at points (n, 3), in their unit

GROWTH = 0.3  # an edge may be longer than another by at most so much of the distance between them
_CHUNK = 512  # points at once
_EVEN = 2.0  # between the longest and the shortest twentieth of the edges, smoothed: more, and a surface is graded


def mean_edge(positions: Floats, triangles: Ints) -> float:
    """Return the mean edge length of a closed surface, in the unit of its positions.

    Parameters
    ----------
    positions : Floats, shape (n, 3)
        Points of the surface.
    triangles : Ints, shape (t, 3)
        Corner indices, counter-clockwise seen from outside.
    """
    edges = positions[triangles] - positions[np.roll(triangles, 1, axis=1)]
    return float(np.linalg.norm(edges, axis=2).mean())


def local_edges(positions: Floats, triangles: Ints) -> Floats:
    """Return the mean length of the edges at each point of a closed surface, (n,), in the unit of its positions."""
    n = len(positions)
    length = np.linalg.norm(positions[triangles] - positions[np.roll(triangles, -1, axis=1)], axis=2)
    total = np.bincount(triangles.ravel(), weights=length.ravel(), minlength=n)
    return total / np.bincount(triangles.ravel(), minlength=n)


def distance_to_line(points: Floats, line: Floats) -> Floats:
    """Return how far points (n, 3) are from a polyline (m, 3), or from a point (1, 3): (n,), in their unit."""
    start, segment = line[:-1], np.diff(line, axis=0)
    if not len(segment):
        start, segment = line, np.zeros_like(line)
    square = np.maximum(np.einsum("mx,mx->m", segment, segment), 1e-300)
    run = np.clip(np.einsum("nmx,mx->nm", points[:, None] - start, segment) / square, 0.0, 1.0)
    apart = points[:, None] - start - run[:, :, None] * segment
    found: Floats = np.linalg.norm(apart, axis=2).min(axis=1)
    return found


def thickness(positions: Floats, triangles: Ints) -> Floats:
    """Return how thick the body is at each point of its surface, (n,), in the unit of its positions.

    That is the diameter of the largest ball inside that touches the surface at the point and on its other side
    (Ma, Bae and Choi 2012): points whose normals point less than a right angle apart count as the same side, so that
    neither curvature nor the steps of flat triangles pass for thinness.
    """
    normal = surface_normals(positions, triangles)
    found = np.empty(len(positions))
    for first in range(0, len(positions), _CHUNK):
        here = slice(first, first + _CHUNK)
        apart = positions[here, None] - positions[None]
        square = np.einsum("ijk,ijk->ij", apart, apart)
        depth = np.einsum("ijk,ik->ij", apart, normal[here])  # of each other point under this one's tangent plane
        other = (normal[here] @ normal.T < 0.0) & (depth > 0.0)
        with np.errstate(divide="ignore", invalid="ignore"):
            found[here] = np.where(other, square / depth, np.inf).min(axis=1)
    return found


def spread(values: Floats, triangles: Ints, times: int) -> Floats:
    """Return values (n,) at points, averaged `times` times over the triangles around them."""
    n = len(values)
    count = np.bincount(triangles.ravel(), minlength=n)
    for _ in range(times):
        mean = values[triangles].mean(axis=1)
        values = np.bincount(triangles.ravel(), weights=np.repeat(mean, 3), minlength=n) / count
    return values


def relative_edges(positions: Floats, triangles: Ints) -> Floats:
    """Return the edges' length at each point over the mean, smoothed, (n,); 1 everywhere on an even surface."""
    length = spread(local_edges(positions, triangles), triangles, 2)
    short, long = np.quantile(length, [0.05, 0.95])
    if long < _EVEN * short:
        return np.ones(len(positions))
    found: Floats = length / local_edges(positions, triangles).mean()
    return found
