"""Resampling of a fine closed surface to an exact number of points: short edges collapse, or long ones split.

Both keep the surface closed and of its genus, so a sphere of N points always has 2 N - 4 triangles. Compiled.
"""

from __future__ import annotations

import numpy as np

from tissue_sim.array_types import Floats, Ints
from tissue_sim.jit import kernel
from tissue_sim.organ.surfaces.remesh import MOST_NEIGHBOURS, Free, Stars, along_edge, collapse_edge, split_edge, stars
from tissue_sim.organ.surfaces.transport import sized_edges


@kernel
def _edges_by_length(positions, triangles, size):  # type: ignore[no-untyped-def]
    """Edges (m, 2), shortest first, and their lengths (m,) in the mean `size` (n,) at their ends."""
    edges, length = sized_edges(positions, triangles, size)
    order = np.argsort(length)
    return edges[order], length[order]


@kernel
def thin_out(positions: Floats, triangles: Ints, most: int) -> tuple[Floats, Ints]:
    """Return the surface after collapsing its shortest edges, none next to another.

    Parameters
    ----------
    positions : Floats, shape (n, 3)
        Points of the surface.
    triangles : Ints, shape (t, 3)
        Corner indices, counter-clockwise seen from outside.
    most : int
        Largest number of collapses.

    Returns
    -------
    tuple[Floats, Ints]
        Points and triangles.
    """
    n = positions.shape[0]
    positions, triangles = positions.copy(), triangles.copy()
    star = stars(triangles, n)
    edges, _ = _edges_by_length(positions, triangles, np.ones(n))
    used = np.zeros(n, dtype=np.bool_)
    gone = np.zeros(n, dtype=np.bool_)
    dead = np.zeros(triangles.shape[0], dtype=np.bool_)
    removed = 0
    for e in range(edges.shape[0]):
        if removed >= most:
            break
        a, b = edges[e, 0], edges[e, 1]
        if used[a] or used[b]:
            continue
        t, s = collapse_edge(positions, triangles, star, a, b)
        if t < 0:
            continue
        dead[t] = dead[s] = True
        gone[b] = True
        removed += 1
        for k in range(star.number[a]):
            for m in range(3):
                used[triangles[star.triangles[a, k], m]] = True
        used[b] = True
    new = np.cumsum(~gone) - 1
    left = triangles[~dead]
    for t in range(left.shape[0]):
        for k in range(3):
            left[t, k] = new[left[t, k]]
    return positions[~gone], left


def thicken(positions: Floats, triangles: Ints, most: int) -> tuple[Floats, Ints]:
    """Return the surface after splitting its longest edges, no two in one triangle.

    Parameters
    ----------
    positions : Floats, shape (n, 3)
        Points of the surface.
    triangles : Ints, shape (t, 3)
        Corner indices, counter-clockwise seen from outside.
    most : int
        Largest number of splits.

    Returns
    -------
    tuple[Floats, Ints]
        Points and triangles.
    """
    found: tuple[Floats, Ints] = split_long(positions, triangles, np.ones(len(positions)), 0.0, most)
    return found


@kernel
def split_long(positions: Floats, triangles: Ints, size: Floats, limit: float, most: int) -> tuple[Floats, Ints]:
    """Split the longest edges, no two in one triangle.

    Parameters
    ----------
    positions : points of a closed surface, (n, 3)
    triangles : outward, (t, 3)
    size : what an edge's length is measured in, the mean of its ends, (n,)
    limit : edges shorter than so many sizes stay
    most : edges to split at most

    Returns
    -------
    positions, triangles : of the new surface, the points before first

    """
    n, faces = positions.shape[0], triangles.shape[0]
    larger = np.zeros((n + most, 3))
    larger[:n] = positions
    more = np.zeros((faces + 2 * most, 3), dtype=np.int32)
    more[:faces] = triangles
    star = Stars(np.full((n + most, MOST_NEIGHBOURS), -1, dtype=np.int32), np.zeros(n + most, dtype=np.int32))
    before = stars(triangles, n)
    star.triangles[:n], star.number[:n] = before.triangles, before.number
    edges, length = _edges_by_length(positions, triangles, size)
    used = np.zeros(faces + 2 * most, dtype=np.bool_)
    added = 0
    for e in range(edges.shape[0] - 1, -1, -1):
        if added >= most or length[e] < limit:
            break
        a, b = edges[e, 0], edges[e, 1]
        t, c = along_edge(more, star, a, b)
        s, d = along_edge(more, star, b, a)
        if used[t] or used[s] or star.number[c] >= MOST_NEIGHBOURS - 2 or star.number[d] >= MOST_NEIGHBOURS - 2:
            continue
        t_new, s_new = faces + 2 * added, faces + 2 * added + 1
        split_edge(larger, more, star, a, b, Free(n + added, t_new, s_new))
        used[t] = used[s] = used[t_new] = used[s_new] = True
        added += 1
    return larger[: n + added], more[: faces + 2 * added]
