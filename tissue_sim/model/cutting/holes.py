"""Holes of a surface: loops of edges with a triangle on one side only, and triangles that fill them."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from tissue_sim.array_types import Longs
from tissue_sim.organ.edges import directed_edges


def hole_triangles(triangles: Longs, rank: Longs) -> Longs:
    """Return triangles that close the holes of a surface.

    Each hole is filled by triangles around the point of its rim that has the lowest rank: two holes at the same place,
    with points of the same ranks, are filled in the same way, so that no volume remains between them.

    Parameters
    ----------
    triangles : Longs, shape (t, 3)
        Corner indices, wound consistently.
    rank : Longs, shape (p,)
        Rank of each point.

    Returns
    -------
    Longs, shape (f, 3)
        The triangles, wound as the surface is.
    """
    ends = open_edges(triangles)
    following: dict[int, list[int]] = {}
    for start, end in ends[::-1].tolist():  # the rim runs opposite to the existing edges
        following.setdefault(end, []).append(start)
    filled = []
    for start in sorted(following):
        while following[start]:
            loop = _loop(start, following)
            first = int(np.argmin(rank[loop]))
            loop = loop[first:] + loop[:first]
            filled += [(loop[0], one, other) for one, other in pairwise(loop[1:])]
    return np.array(filled, dtype=np.int64).reshape(-1, 3)


def _loop(start: int, following: dict[int, list[int]]) -> list[int]:
    """Remove a loop through a point from the edges that follow each other: the shortest that doesn't cross itself."""
    way, place = [start], {start: 0}
    while True:
        point = following[way[-1]].pop()
        if point in place:
            again = place[point]
            loop = way[again:]
            # The edges that led to the loop belong to another one.
            for one, other in pairwise(way[: again + 1]):
                following[one].append(other)
            return loop
        place[point] = len(way)
        way.append(point)


def open_edges(triangles: Longs) -> Longs:
    """Return directed edges (k, 2) of triangles that have no opposite; one that occurs twice counts twice.

    Parameters
    ----------
    triangles : Longs, shape (t, 3)
        Corner indices.
    """
    size = int(triangles.max(initial=0)) + 1
    directed = directed_edges(triangles)
    low, high = directed.min(axis=1), directed.max(axis=1)
    key, inverse = np.unique(low * size + high, return_inverse=True)
    ways = np.where(directed[:, 0] < directed[:, 1], 1, -1)
    excess = np.bincount(inverse.ravel(), ways, len(key)).astype(np.int64)
    one, other = np.divmod(key, size)
    edges = np.stack([np.where(excess > 0, one, other), np.where(excess > 0, other, one)], axis=1)
    found: Longs = np.repeat(edges, np.abs(excess), axis=0)
    return found
