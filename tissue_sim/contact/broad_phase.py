"""Broad phase: the part of the surface near a tool, by compiled sweeps over boxes and points."""

from __future__ import annotations

import math
from typing import NamedTuple

from tissue_sim.array_types import Floats, Longs
from tissue_sim.jit import kernel
from tissue_sim.model.contact.shapes import signed_distance
from tissue_sim.model.data.shapes import Shapes


@kernel
def surface_box(position: Floats, n_surface: int, low: Floats, high: Floats) -> None:
    """Write the axis-aligned box of the surface nodes to `low` and `high`.

    Parameters
    ----------
    position : Floats, shape (n, 3), m
        Positions of the nodes, surface first.
    n_surface : int
        Number of surface nodes.
    low, high : Floats, shape (3,), m
        Receive the lower and the upper corner of the box.
    """
    for c in range(3):
        low[c] = high[c] = position[0, c]
    for node in range(1, n_surface):
        for c in range(3):
            low[c] = min(low[c], position[node, c])
            high[c] = max(high[c], position[node, c])


@kernel
def body_box(corners: Floats, padding: float, rotation: Floats, origin: Floats, low: Floats, high: Floats) -> None:
    """Write the axis-aligned box of a body to `low` and `high`.

    Parameters
    ----------
    corners : Floats, shape (k, 3), m
        Points whose hull, enlarged by `padding`, contains the body.
    padding : float, m
        Distance by which the hull is enlarged.
    rotation : Floats, shape (9,)
        Rotation matrix, row by row.
    origin : Floats, shape (3,), m
        Origin of the body.
    low, high : Floats, shape (3,), m
        Receive the lower and the upper corner of the box.
    """
    for c in range(3):
        low[c], high[c] = math.inf, -math.inf
    for k in range(len(corners)):
        for c in range(3):
            x, y, z = corners[k, 0], corners[k, 1], corners[k, 2]
            at = rotation[3 * c] * x + rotation[3 * c + 1] * y + rotation[3 * c + 2] * z + origin[c]
            low[c] = min(low[c], at - padding)
            high[c] = max(high[c], at + padding)


@kernel
def boxes_meet(low: Floats, high: Floats, other_low: Floats, other_high: Floats) -> bool:
    """Return whether two boxes have a point in common.

    Parameters
    ----------
    low, high : Floats, shape (3,), m
        Lower and upper corner of the box.
    other_low, other_high : Floats, shape (3,), m
        Those of the other box.
    """
    apart = False
    for c in range(3):
        apart = apart or low[c] > other_high[c] or high[c] < other_low[c]
    return not apart


@kernel
def boxes_apart(low: Floats, high: Floats, other_low: Floats, other_high: Floats) -> float:
    """Return the largest distance between two boxes along an axis.

    Parameters
    ----------
    low, high : Floats, shape (3,), m
        Lower and upper corner of the box.
    other_low, other_high : Floats, shape (3,), m
        Those of the other box.

    Returns
    -------
    float, m
        The distance; 0 where they meet.
    """
    apart = 0.0
    for c in range(3):
        apart = max(apart, low[c] - other_high[c], other_low[c] - high[c])
    return apart


class NearTriangles(NamedTuple):
    """Buffers for triangles that lie near a box."""

    node: Longs  # (t, 3) their nodes
    number: Longs  # (t,) their indices


@kernel
def triangles_in_box(
    position: Floats, rest: Floats, triangles: Longs, low: Floats, high: Floats, near: NearTriangles
) -> tuple[int, float]:
    """Write the triangles (t, 3) whose box overlaps the box low, high (3,) to near.

    Returns their number, and the largest displacement of their nodes from rest (n, 3) along an axis, m.
    """
    count, moved = 0, 0.0
    for t in range(len(triangles)):
        i, j, k = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        apart = False
        for c in range(3):
            a, b, d = position[i, c], position[j, c], position[k, c]
            apart = apart or min(a, b, d) > high[c] or max(a, b, d) < low[c]
        if not apart:
            for c in range(3):
                node = triangles[t, c]
                near.node[count, c] = node
                for axis in range(3):
                    moved = max(moved, abs(position[node, axis] - rest[node, axis]))
            near.number[count] = t
            count += 1
    return count, moved


@kernel
def nearest_node(position: Floats, n_surface: int, x: float, y: float, z: float) -> tuple[int, float]:
    """Return the surface node nearest to a point.

    Parameters
    ----------
    position : Floats, shape (n, 3), m
        Positions of the nodes, surface first.
    n_surface : int
        Number of surface nodes.
    x, y, z : float, m
        The point.

    Returns
    -------
    tuple[int, float]
        The node, and its squared distance, m^2.
    """
    best, chosen = 1e300, -1
    for node in range(n_surface):
        dx, dy, dz = position[node, 0] - x, position[node, 1] - y, position[node, 2] - z
        distance = dx * dx + dy * dy + dz * dz
        if distance < best:
            best, chosen = distance, node
    return chosen, best


class PlacedBody(NamedTuple):
    """A body at its pose: origin (3,), rotation (9,), and its box low, high (3,), m."""

    shapes: Shapes
    body: int
    origin: Floats
    rotation: Floats
    low: Floats
    high: Floats


@kernel
def holds_node(position: Floats, n_surface: int, placed: PlacedBody) -> bool:
    """Return whether a surface node lies inside a body."""
    shapes, body, origin, r, low, high = placed
    for node in range(n_surface):
        x, y, z = position[node, 0], position[node, 1], position[node, 2]
        if x < low[0] or y < low[1] or z < low[2] or x > high[0] or y > high[1] or z > high[2]:
            continue
        x, y, z = x - origin[0], y - origin[1], z - origin[2]
        lx, ly, lz = r[0] * x + r[3] * y + r[6] * z, r[1] * x + r[4] * y + r[7] * z, r[2] * x + r[5] * y + r[8] * z
        if signed_distance(shapes, body, lx, ly, lz)[0] < 0.0:
            return True
    return False


@kernel
def approach(first: Floats, first_before: Floats, second: Floats, second_before: Floats) -> float:
    """Return a bound on the decrease of the distance between any two points of two surfaces.

    Common motion of both, as with breathing, doesn't count.

    Parameters
    ----------
    first : Floats, shape (n, 3), m
        One surface.
    first_before : Floats, shape (n, 3), m
        The same, earlier.
    second : Floats, shape (m, 3), m
        The other surface.
    second_before : Floats, shape (m, 3), m
        The same, earlier.

    Returns
    -------
    float, m
        The bound.
    """
    x = y = z = 0.0
    for node in range(len(first)):
        x += (first[node, 0] - first_before[node, 0]) / len(first)
        y += (first[node, 1] - first_before[node, 1]) / len(first)
        z += (first[node, 2] - first_before[node, 2]) / len(first)
    return _farthest(first, first_before, (x, y, z)) + _farthest(second, second_before, (x, y, z))


@kernel
def _farthest(now: Floats, before: Floats, shift: tuple[float, float, float]) -> float:
    """Return the largest distance of points (n, 3) m from where a shift, m, would have moved them."""
    most = 0.0
    for node in range(len(now)):
        square = 0.0
        for axis in range(3):
            square += (now[node, axis] - before[node, axis] - shift[axis]) ** 2
        most = max(most, square)
    return most**0.5
