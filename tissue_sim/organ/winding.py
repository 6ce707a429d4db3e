"""Inside or outside: the winding number of a closed triangle surface."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissue_sim.array_types import Floats, Ints, Longs
from tissue_sim.jit import kernel


def winding_number(points: Floats, positions: Floats, triangles: Ints | Longs) -> Floats:
    """Winding number of a closed surface about each point, (p,): 1 inside, 0 outside.

    points (p, 3), positions (n, 3), triangles (t, 3). Sum of the triangles' solid angles
    (van Oosterom & Strackee 1983).
    """
    found = np.empty(len(points))
    _add_angles(np.asarray(points, dtype=np.float64), np.asarray(positions[triangles], dtype=np.float64), found)
    return found


def inside(points: Floats, positions: Floats, triangles: Ints) -> NDArray[np.bool_]:
    """Whether each of points (p, 3) lies inside the closed outward surface."""
    return winding_number(points, positions, triangles) > 0.5


@kernel
def _add_angles(points: Any, corners: Any, found: Any) -> None:
    for p in range(len(points)):
        x, y, z = points[p, 0], points[p, 1], points[p, 2]
        total = 0.0
        for t in range(len(corners)):
            ax, ay, az = corners[t, 0, 0] - x, corners[t, 0, 1] - y, corners[t, 0, 2] - z
            bx, by, bz = corners[t, 1, 0] - x, corners[t, 1, 1] - y, corners[t, 1, 2] - z
            cx, cy, cz = corners[t, 2, 0] - x, corners[t, 2, 1] - y, corners[t, 2, 2] - z
            la = math.sqrt(ax * ax + ay * ay + az * az)
            lb = math.sqrt(bx * bx + by * by + bz * bz)
            lc = math.sqrt(cx * cx + cy * cy + cz * cz)
            volume = ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)
            below = la * lb * lc + (ax * bx + ay * by + az * bz) * lc
            below += (bx * cx + by * cy + bz * cz) * la + (cx * ax + cy * ay + cz * az) * lb
            total += math.atan2(volume, below)
        found[p] = total / (2.0 * math.pi)
