"""A surface cut along contour lines of a value, for pictures in which a mesh has one colour."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tissue_sim.array_types import Floats, Longs


def cut_into_bands(
    vertices: Floats, triangles: Longs, values: Floats, levels: Sequence[float]
) -> list[tuple[Floats, Longs]]:
    """Cut a mesh where linearly interpolated values (n,) at its vertices cross ascending levels.

    vertices (n, 3), triangles (t, 3). Returns len(levels) + 1 meshes (vertices, triangles) from low values
    to high, which together cover the surface once; a band without any surface is empty.
    """
    points, found = np.column_stack([vertices, values]), []
    rest = np.asarray(triangles, dtype=np.int64)
    for level in levels:
        points, below, rest = _split(points, rest, level)
        found.append(_compact(points, below))
    return [*found, _compact(points, rest)]


def _split(points: Floats, triangles: Longs, level: float) -> tuple[Floats, Longs, Longs]:
    """Split triangles at a level of the points' last column: all points, triangles below, triangles above."""
    above = points[:, 3] > level
    corners = above[triangles]
    count = corners.sum(axis=1)
    lone, pair = count == 1, count == 2
    mixed = np.concatenate([triangles[lone], triangles[pair]])
    if len(mixed) == 0:
        return points, triangles[count == 0], triangles[count == 3]
    # Turn each so that its first corner is alone on its side.
    alone = np.where(np.repeat([True, False], [lone.sum(), pair.sum()]), above[mixed].T, ~above[mixed].T)
    first = alone.argmax(axis=0)
    a, b, c = (np.take_along_axis(mixed, ((first + k) % 3)[:, None], axis=1)[:, 0] for k in range(3))
    # Neighbours share the points of the edges that they share.
    edges = np.sort(np.concatenate([np.stack([a, b], axis=1), np.stack([a, c], axis=1)]), axis=1)
    edges, which = np.unique(edges, axis=0, return_inverse=True)
    start, end = points[edges[:, 0]], points[edges[:, 1]]
    share = (level - start[:, 3:]) / (end[:, 3:] - start[:, 3:])
    cut = start + share * (end - start)
    ab, ac = (len(points) + which.ravel()).reshape(2, -1)
    tip = np.stack([a, ab, ac], axis=1)
    base = np.stack([np.stack([ab, b, c], axis=1), np.stack([ab, c, ac], axis=1)])
    n = int(lone.sum())
    below = np.concatenate([triangles[count == 0], *base[:, :n], tip[n:]])
    over = np.concatenate([triangles[count == 3], tip[:n], *base[:, n:]])
    return np.concatenate([points, cut]), below, over


def _compact(points: Floats, triangles: Longs) -> tuple[Floats, Longs]:
    """The triangles with the points that they use, and no others."""
    used, which = np.unique(triangles, return_inverse=True)
    return points[used, :3], which.reshape(-1, 3)
