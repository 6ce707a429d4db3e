"""Inside or outside: the winding number of a closed triangle surface."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tissue_sim.array_types import Floats, Ints, Longs
from tissue_sim.jit import kernel

_TOGETHER = 64  # triangles of a group at the most
_AFAR = 3.0  # times as far as a group reaches: from there it counts as one
_FEW = 16  # points that are asked of every triangle sooner than groups are made
_DOUBT = 0.2  # off a whole number, from which a winding number is worked out in full


class _Groups(NamedTuple):
    """Triangles in groups that lie together, and each group as it is seen from afar."""

    corners: Any  # (t, 3, 3) of the triangles, group by group
    starts: Any  # (g + 1,) where groups start
    middle: Any  # (g, 3)
    area: Any  # (g, 3) times the normal
    afar: Any  # (g,) the square of where afar begins


def winding_number(points: Floats, positions: Floats, triangles: Ints | Longs) -> Floats:
    """Winding number of a closed surface about each point, (p,): 1 inside, 0 outside.

    points (p, 3), positions (n, 3), triangles (t, 3). Sum of the triangles' solid angles
    (van Oosterom & Strackee 1983).
    """
    found = np.empty(len(points))
    _add_angles(np.asarray(points, dtype=np.float64), np.asarray(positions[triangles], dtype=np.float64), found)
    return found


def inside(points: Floats, positions: Floats, triangles: Ints) -> NDArray[np.bool_]:
    """Whether each of points (p, 3) lies inside the closed outward surface.

    Points beyond all positions lie outside. Triangles that lie together count as one where a point is far from them
    (Barill et al. 2018); a point for which that leaves a doubt is asked of every triangle.
    """
    points = np.asarray(points, dtype=np.float64)
    near = np.all((points >= positions.min(axis=0)) & (points <= positions.max(axis=0)), axis=1)
    if near.any():
        near[near] = _is_wound(points[near], positions, triangles)
    return near


def _is_wound(points: Floats, positions: Floats, triangles: Ints) -> NDArray[np.bool_]:
    if len(points) <= _FEW:
        return winding_number(points, positions, triangles) > 0.5
    corners, starts = _groups(np.asarray(positions[triangles], dtype=np.float64))
    found = np.empty(len(points))
    _add_groups(points, _Groups(corners, starts, *_seen_from_afar(corners, starts)), found)
    doubted = np.flatnonzero(np.abs(found - np.rint(found)) > _DOUBT)
    found[doubted] = winding_number(points[doubted], positions, triangles)
    return found > 0.5


def _groups(corners: Floats) -> tuple[Floats, Longs]:
    """Triangles (t, 3, 3) in an order in which those of a group lie together, and where groups start, (g + 1,)."""
    middle = corners.mean(axis=1)
    parts = [np.arange(len(corners))]
    while len(parts[0]) > _TOGETHER:
        halves = []
        for part in parts:
            axis = int(np.ptp(middle[part], axis=0).argmax())
            ordered = part[np.argsort(middle[part, axis], kind="stable")]
            halves += [ordered[: len(part) // 2], ordered[len(part) // 2 :]]
        parts = halves
    return np.ascontiguousarray(corners[np.concatenate(parts)]), np.cumsum([0, *map(len, parts)])


def _seen_from_afar(corners: Floats, starts: Longs) -> tuple[Floats, Floats, Floats]:
    """Of each group its middle (g, 3), its area times normal (g, 3) and the square (g,) of where afar begins."""
    area = 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    weight = np.linalg.norm(area, axis=1)[:, None] + 1e-300
    total = np.add.reduceat(weight, starts[:-1])
    middle = np.add.reduceat(weight * corners.mean(axis=1), starts[:-1]) / total
    apart = np.linalg.norm(corners - np.repeat(middle, np.diff(starts), axis=0)[:, None], axis=2).max(axis=1)
    reach = np.maximum.reduceat(apart, starts[:-1])
    return middle, np.add.reduceat(area, starts[:-1]), (_AFAR * reach) ** 2


@kernel
def _add_angles(points: Any, corners: Any, found: Any) -> None:
    for p in range(len(points)):
        total = 0.0
        for t in range(len(corners)):
            total += _half_angle(corners[t], points[p, 0], points[p, 1], points[p, 2])
        found[p] = total / (2.0 * math.pi)


@kernel
def _half_angle(corner: Any, x: float, y: float, z: float) -> float:
    """Half of the solid angle of a triangle (3, 3), seen from a point."""
    ax, ay, az = corner[0, 0] - x, corner[0, 1] - y, corner[0, 2] - z
    bx, by, bz = corner[1, 0] - x, corner[1, 1] - y, corner[1, 2] - z
    cx, cy, cz = corner[2, 0] - x, corner[2, 1] - y, corner[2, 2] - z
    la = math.sqrt(ax * ax + ay * ay + az * az)
    lb = math.sqrt(bx * bx + by * by + bz * bz)
    lc = math.sqrt(cx * cx + cy * cy + cz * cz)
    volume = ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)
    below = la * lb * lc + (ax * bx + ay * by + az * bz) * lc
    below += (bx * cx + by * cy + bz * cz) * la + (cx * ax + cy * ay + cz * az) * lb
    return math.atan2(volume, below)


@kernel
def _add_groups(points: Any, groups: Any, found: Any) -> None:
    corners, starts, middle, area, afar = groups
    for p in range(len(points)):
        x, y, z = points[p, 0], points[p, 1], points[p, 2]
        total = 0.0
        for g in range(len(middle)):
            dx, dy, dz = middle[g, 0] - x, middle[g, 1] - y, middle[g, 2] - z
            square = dx * dx + dy * dy + dz * dz
            if square > afar[g]:
                total += 0.5 * (area[g, 0] * dx + area[g, 1] * dy + area[g, 2] * dz) / (square * math.sqrt(square))
            else:
                for t in range(starts[g], starts[g + 1]):
                    total += _half_angle(corners[t], x, y, z)
        found[p] = total / (2.0 * math.pi)
