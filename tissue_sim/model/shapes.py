"""Rigid tool shapes as the kernels see them: signed distance and normal in the tool's frame."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from tissue_sim.jit import kernel

SPHERE, CAPSULE, CONVEX = 0, 1, 2


class Shapes(NamedTuple):
    """Shapes of T tools, each in its own frame, whose origin is the tool's tip.

    A capsule runs from the origin along -z, where an instrument's shaft lies.
    """

    kind: Any  # (T,) SPHERE, CAPSULE or CONVEX
    size: Any  # (T, 2) m: radius, and the capsule's length between the centres of its caps
    plane: Any  # (P, 4) outward normals and offsets of convex shapes: n.y <= d inside
    plane_start: Any  # (T + 1,) which planes belong to which tool


@kernel
def rotation_matrix(quaternion: Any, matrix: Any) -> None:
    """Write the rotation matrix (9,) row by row of a unit quaternion xyzw."""
    x, y, z, w = quaternion[0], quaternion[1], quaternion[2], quaternion[3]
    matrix[0], matrix[1], matrix[2] = 1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)
    matrix[3], matrix[4], matrix[5] = 2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)
    matrix[6], matrix[7], matrix[8] = 2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)


@kernel
def signed_distance(shapes: Any, tool: int, x: float, y: float, z: float) -> tuple[float, float, float, float]:
    """Distance of a point in the tool's frame to the tool's surface, m, and the outward normal.

    Negative inside. Outside a convex shape's edges the distance is a lower bound.
    """
    if shapes.kind[tool] == CONVEX:
        start = shapes.plane_start[tool]
        best, chosen = -math.inf, start
        for p in range(start, shapes.plane_start[tool + 1]):
            gap = shapes.plane[p, 0] * x + shapes.plane[p, 1] * y + shapes.plane[p, 2] * z - shapes.plane[p, 3]
            if gap > best:
                best, chosen = gap, p
        return best, shapes.plane[chosen, 0], shapes.plane[chosen, 1], shapes.plane[chosen, 2]
    if shapes.kind[tool] == CAPSULE:
        z -= min(0.0, max(-shapes.size[tool, 1], z))
    length = math.sqrt(x * x + y * y + z * z)
    if length < 1e-12:
        return -shapes.size[tool, 0], 0.0, 0.0, 1.0
    return length - shapes.size[tool, 0], x / length, y / length, z / length
