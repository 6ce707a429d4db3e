"""Rigid tool shapes for the kernels: signed distance and normal in the tool's frame."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from tissue_sim.array_types import Floats
from tissue_sim.jit import kernel

SPHERE, CAPSULE, CONVEX, GRID = 0, 1, 2, 3


class Shapes(NamedTuple):
    """Shapes of T rigid bodies, each in its own frame, whose origin is the tip.

    A capsule runs from the origin along -z, where an instrument's shaft lies. A shape that is not convex is a grid of
    signed distances. The bodies of one tool, as the two jaws of a gripper, are held as one.
    """

    kind: Any  # (T,) SPHERE, CAPSULE, CONVEX or GRID
    size: Any  # (T, 2) m: radius, and the capsule's length between the centres of its caps
    plane: Any  # (P, 4) outward normals and offsets of convex shapes: n.y <= d inside
    plane_start: Any  # (T + 1,) which planes belong to which body
    distance: Any  # (G,) m, signed distances at the points of every grid, the last axis running fastest
    grid_start: Any  # (T,) first distance of each
    grid_points: Any  # (T, 3) points along each axis
    grid_frame: Any  # (T, 4) m: first point, and the spacing
    tool: Any  # (T,) which tool each body belongs to
    finest: Any  # (T,) m, smallest radius of each body
    extent: Any  # (T,) m, from the origin to the farthest point that a turn moves
    smoothing: Any  # (T,) fraction of the time between two poses in which a body moves to the newer one


def make_shapes(
    kind: ArrayLike,
    size: ArrayLike,
    planes: Sequence[Floats] | None = None,
    grids: Sequence[Grid | None] | None = None,
    tool: ArrayLike | None = None,
    measures: Sequence[tuple[float, float]] | None = None,
    smoothing: ArrayLike = 1.0,
) -> Shapes:
    """Return the shapes of bodies.

    measures (T, 2) m: `Shapes.finest` and `Shapes.extent` of each; those of spheres and capsules unless given.

    Parameters
    ----------
    kind : ArrayLike, shape (T,)
        SPHERE, CAPSULE, CONVEX or GRID.
    size : ArrayLike, shape (T, 2), m
        Radius, and a capsule's length.
    planes : Sequence[Floats] | None, shape (p, 4) each, optional
        Planes of convex bodies; None for none.
    grids : Sequence[Grid | None] | None, optional
        Grids of bodies that aren't convex; None for none.
    tool : ArrayLike | None, shape (T,), optional
        Tool of each body; None for one of its own.
    measures : Sequence[tuple[float, float]] | None, shape (T, 2), m, optional
        `Shapes.finest` and `Shapes.extent` of each; None for those of spheres and capsules.
    smoothing : ArrayLike, optional
        `Shapes.smoothing` of each, or of all.

    Returns
    -------
    Shapes
        The shapes.
    """
    kinds = np.asarray(kind, dtype=np.int64).reshape(-1)
    n = len(kinds)
    planes = [np.zeros((0, 4))] * n if planes is None else planes
    grids = [None] * n if grids is None else grids
    counts = [len(one) for one in planes]
    sizes = [0 if grid is None else grid.distance.size for grid in grids]
    size = np.asarray(size, dtype=np.float64).reshape(n, 2)
    measured = np.asarray(size if measures is None else measures, dtype=np.float64).reshape(n, 2)
    return Shapes(
        kind=kinds,
        size=size,
        plane=np.concatenate([*planes, np.zeros((0, 4))]),
        plane_start=np.concatenate([[0], np.cumsum(counts)]).astype(np.int64),
        distance=np.concatenate([*(grid.distance.ravel() for grid in grids if grid is not None), np.zeros(0)]),
        grid_start=(np.cumsum(sizes) - sizes).astype(np.int64),
        grid_points=np.array(
            [(0, 0, 0) if grid is None else grid.distance.shape for grid in grids], dtype=np.int64
        ).reshape(n, 3),
        grid_frame=np.array(
            [(0.0, 0.0, 0.0, 1.0) if grid is None else (*grid.origin, grid.spacing) for grid in grids], dtype=np.float64
        ).reshape(n, 4),
        tool=np.arange(n, dtype=np.int64) if tool is None else np.asarray(tool, dtype=np.int64),
        finest=measured[:, 0].copy(),
        extent=measured[:, 1].copy(),
        smoothing=np.broadcast_to(np.asarray(smoothing, dtype=np.float64), n).copy(),
    )


class Grid(NamedTuple):
    """Signed distances (i, j, k) m at points `spacing` m apart, the first of which is at origin (3,) m."""

    distance: Floats
    origin: Floats
    spacing: float


@kernel
def rotation_matrix(quaternion: Any, matrix: Any) -> None:
    """Write the rotation matrix of a unit quaternion.

    Parameters
    ----------
    quaternion : Any, xyzw
        The quaternion.
    matrix : Any, shape (9,)
        Receives the matrix, row by row.
    """
    x, y, z, w = quaternion[0], quaternion[1], quaternion[2], quaternion[3]
    matrix[0], matrix[1], matrix[2] = 1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)
    matrix[3], matrix[4], matrix[5] = 2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)
    matrix[6], matrix[7], matrix[8] = 2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)


@kernel
def grid_distance(shapes: Any, body: int, x: float, y: float, z: float) -> tuple[float, float, float, float]:
    """Return the distance interpolated on a body's grid, m, and its gradient; beyond the grid a lower bound."""
    frame, points, table = shapes.grid_frame[body], shapes.grid_points[body], shapes.distance
    spacing = frame[3]
    u, v, w = (x - frame[0]) / spacing, (y - frame[1]) / spacing, (z - frame[2]) / spacing
    a = min(max(u, 0.0), points[0] - 1.000001)
    b = min(max(v, 0.0), points[1] - 1.000001)
    c = min(max(w, 0.0), points[2] - 1.000001)
    i, j, k = int(a), int(b), int(c)
    beyond = spacing * math.sqrt((u - a) ** 2 + (v - b) ** 2 + (w - c) ** 2)
    a, b, c = a - i, b - j, c - k
    at = shapes.grid_start[body] + (i * points[1] + j) * points[2] + k
    right, row = points[1] * points[2], points[2]
    d000, d001, d010, d011 = table[at], table[at + 1], table[at + row], table[at + row + 1]
    at += right
    d100, d101, d110, d111 = table[at], table[at + 1], table[at + row], table[at + row + 1]
    e00, e01 = d000 + a * (d100 - d000), d001 + a * (d101 - d001)
    e10, e11 = d010 + a * (d110 - d010), d011 + a * (d111 - d011)
    f0, f1 = e00 + b * (e10 - e00), e01 + b * (e11 - e01)
    gap = f0 + c * (f1 - f0)
    near = (1.0 - c) * (d100 - d000) + c * (d101 - d001)
    far = (1.0 - c) * (d110 - d010) + c * (d111 - d011)
    nx = (1.0 - b) * near + b * far
    ny = (1.0 - c) * (e10 - e00) + c * (e11 - e01)
    nz = f1 - f0
    if beyond > 0.0:  # the body lies in the grid's box: from its nearest place, no nearer than square to the way there
        gap = math.sqrt(gap * gap + beyond * beyond)
    length = math.sqrt(nx * nx + ny * ny + nz * nz)
    if length < 1e-12:
        return gap, 0.0, 0.0, 1.0
    return gap, nx / length, ny / length, nz / length


@kernel
def signed_distance(shapes: Any, body: int, x: float, y: float, z: float) -> tuple[float, float, float, float]:
    """Return the distance of a point in the tool's frame from the tool's surface, and the outward normal.

    It is negative inside. Outside a convex shape's edges the distance is a lower bound, and so it is beyond a grid.

    Parameters
    ----------
    shapes : Any
        Shapes of the bodies.
    body : int
        Index of the body.
    x : float, m
        Coordinate of the point.
    y : float, m
        Coordinate of the point.
    z : float, m
        Coordinate of the point.

    Returns
    -------
    tuple[float, float, float, float]
        Distance, m, and normal.
    """
    if shapes.kind[body] == GRID:
        return grid_distance(shapes, body, x, y, z)
    if shapes.kind[body] == CONVEX:
        start = shapes.plane_start[body]
        best, chosen = -math.inf, start
        for p in range(start, shapes.plane_start[body + 1]):
            gap = shapes.plane[p, 0] * x + shapes.plane[p, 1] * y + shapes.plane[p, 2] * z - shapes.plane[p, 3]
            if gap > best:
                best, chosen = gap, p
        return best, shapes.plane[chosen, 0], shapes.plane[chosen, 1], shapes.plane[chosen, 2]
    if shapes.kind[body] == CAPSULE:
        z -= min(0.0, max(-shapes.size[body, 1], z))
    length = math.sqrt(x * x + y * y + z * z)
    if length < 1e-12:
        return -shapes.size[body, 0], 0.0, 0.0, 1.0
    return length - shapes.size[body, 0], x / length, y / length, z / length
