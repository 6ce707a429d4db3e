"""Test whether a point lies inside a closed surface, by the triangles that a ray from the point crosses."""

from __future__ import annotations

from tissue_sim.array_types import Floats, Ints, Longs
from tissue_sim.jit import kernel

TRACE = 1e-300  # m^2


@kernel
def crossings_above(position: Floats, triangles: Ints | Longs, x: float, y: float, z: float) -> int:
    """Return the number of triangles through which the ray from a point along z leaves, minus those where it enters.

    That is the surface's winding number about the point: 1 inside. Where the ray meets an edge, one of its two
    triangles is crossed: `_side` is the same number for both, with the other sign. Surfaces whose triangles share no
    nodes where they meet, as beside cuts, need `organ.winding`.

    Parameters
    ----------
    position : Floats, shape (n, 3), m
        Positions of the nodes.
    triangles : Ints | Longs, shape (t, 3)
        Corner indices, counter-clockwise seen from outside.
    x, y, z : float, m
        The point.
    """
    total = 0
    for t in range(len(triangles)):
        i, j, k = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        ax, bx, cx = position[i, 0], position[j, 0], position[k, 0]
        if max(ax, bx, cx) < x or min(ax, bx, cx) > x:
            continue
        ay, by, cy = position[i, 1], position[j, 1], position[k, 1]
        az, bz, cz = position[i, 2], position[j, 2], position[k, 2]
        if max(ay, by, cy) < y or min(ay, by, cy) > y or max(az, bz, cz) < z:
            continue
        first, second, third = _side(position, i, j, x, y), _side(position, j, k, x, y), _side(position, k, i, x, y)
        is_up = first >= 0.0 and second >= 0.0 and third >= 0.0
        if not is_up and not (first < 0.0 and second < 0.0 and third < 0.0):
            continue
        area = first + second + third
        if area == 0.0:
            continue
        height = (second * az + third * bz + first * cz) / area
        if height > z:
            total += 1 if is_up else -1
    return total


@kernel
def _side(position: Floats, i: int, j: int, x: float, y: float) -> float:
    """Return on which side of the edge from node i to node j a point lies, seen along z; never 0.

    A point on the edge is shifted by a tiny distance along y, and a much smaller one along x, the same for all edges,
    so that above a node one triangle is crossed, too (Edelsbrunner and Muecke 1990: Simulation of simplicity).
    """
    low, high = min(i, j), max(i, j)
    a, b = position[low], position[high]
    along, across = b[0] - a[0], b[1] - a[1]
    side = along * (y - a[1]) - across * (x - a[0])
    if side == 0.0:
        beyond = along if along != 0.0 else -across
        side = TRACE if beyond >= 0.0 else -TRACE
    return side if low == i else -side
