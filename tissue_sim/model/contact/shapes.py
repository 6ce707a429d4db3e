"""Rigid tool shapes for the kernels: signed distance and normal in the tool's frame."""

from __future__ import annotations

import math

from tissue_sim.array_types import Floats
from tissue_sim.jit import kernel
from tissue_sim.model.data.shapes import CAPSULE, CONVEX, GRID, Shapes


@kernel
def rotation_matrix(quaternion: Floats, matrix: Floats) -> None:
    """Write the rotation matrix of a unit quaternion.

    Parameters
    ----------
    quaternion : Floats, xyzw
        The quaternion.
    matrix : Floats, shape (9,)
        Receives the matrix, row by row.
    """
    x, y, z, w = quaternion[0], quaternion[1], quaternion[2], quaternion[3]
    matrix[0], matrix[1], matrix[2] = 1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)
    matrix[3], matrix[4], matrix[5] = 2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)
    matrix[6], matrix[7], matrix[8] = 2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)


@kernel
def grid_distance(shapes: Shapes, body: int, x: float, y: float, z: float) -> tuple[float, float, float, float]:
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
    if beyond > 0.0:  # no nearer than the hypotenuse, as the body lies in the grid's box
        gap = math.sqrt(gap * gap + beyond * beyond)
    length = math.sqrt(nx * nx + ny * ny + nz * nz)
    if length < 1e-12:
        return gap, 0.0, 0.0, 1.0
    return gap, nx / length, ny / length, nz / length


@kernel
def signed_distance(shapes: Shapes, body: int, x: float, y: float, z: float) -> tuple[float, float, float, float]:
    """Return the distance of a point in the tool's frame from the tool's surface, and the outward normal.

    It is negative inside. Outside a convex shape's edges the distance is a lower bound, and so it is beyond a grid.

    Parameters
    ----------
    shapes : Shapes
        Shapes of the bodies.
    body : int
        Index of the body.
    x, y, z : float, m
        The point.

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
