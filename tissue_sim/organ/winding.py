"""Winding number of a closed triangle surface, which distinguishes inside from outside."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tissue_sim.array_types import Floats, Ints, Longs
from tissue_sim.jit import kernel

_TOGETHER = 64  # largest number of triangles in a group
_AFAR = 3.0  # times the radius of a group: from that distance it counts as one
_FEW = 16  # points up to which testing every triangle is faster than making groups
_DOUBT = 0.2  # deviation from a whole number, from which a winding number is computed in full


class _Groups(NamedTuple):
    """Triangles in groups that lie together, and each group as it is seen from afar."""

    corners: Floats  # (t, 3, 3) of the triangles, group by group
    starts: Longs  # (g + 1,) where groups start
    middle: Floats  # (g, 3)
    area: Floats  # (g, 3) times the normal
    afar: Floats  # (g,) the square of where afar begins


def winding_number(points: Floats, positions: Floats, triangles: Ints | Longs) -> Floats:
    """Return the winding number of a closed surface about each point: 1 inside, 0 outside.

    Parameters
    ----------
    points : Floats, shape (p, 3)
        Points.
    positions : Floats, shape (n, 3)
        Points of the surface.
    triangles : Ints | Longs, shape (t, 3)
        Corner indices, counter-clockwise seen from outside.

    Returns
    -------
    Floats, shape (p,)
        Winding numbers.

    References
    ----------
    van Oosterom & Strackee 1983: The solid angle of a plane triangle.
    """
    found = np.empty(len(points))
    _add_angles(np.asarray(points, dtype=np.float64), np.asarray(positions[triangles], dtype=np.float64), found)
    return found


def inside(points: Floats, positions: Floats, triangles: Ints) -> NDArray[np.bool_]:
    """Return whether each point lies inside a closed outward surface.

    Triangles that lie together count as one where a point is far from them; a point for which the result is uncertain
    is tested against every triangle.

    Parameters
    ----------
    points : Floats, shape (p, 3)
        Points.
    positions : Floats, shape (n, 3)
        Points of the surface.
    triangles : Ints, shape (t, 3)
        Corner indices, counter-clockwise seen from outside.

    Returns
    -------
    NDArray[np.bool_], shape (p,)
        True inside.

    References
    ----------
    Barill et al. 2018: Fast winding numbers for soups and clouds.
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
    """Return triangles (t, 3, 3) in an order in which groups are contiguous, and the groups' starts (g + 1,)."""
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
    """Return each group's centre (g, 3), area times normal (g, 3), and the square (g,) of its far distance."""
    area = 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    weight = np.linalg.norm(area, axis=1)[:, None] + 1e-300
    total = np.add.reduceat(weight, starts[:-1])
    middle = np.add.reduceat(weight * corners.mean(axis=1), starts[:-1]) / total
    apart = np.linalg.norm(corners - np.repeat(middle, np.diff(starts), axis=0)[:, None], axis=2).max(axis=1)
    reach = np.maximum.reduceat(apart, starts[:-1])
    return middle, np.add.reduceat(area, starts[:-1]), (_AFAR * reach) ** 2


@kernel
def _add_angles(points: Floats, corners: Floats, found: Floats) -> None:
    for p in range(len(points)):
        total = 0.0
        for t in range(len(corners)):
            total += _half_angle(corners[t], points[p, 0], points[p, 1], points[p, 2])
        found[p] = total / (2.0 * math.pi)


@kernel
def _half_angle(corner: Floats, x: float, y: float, z: float) -> float:
    """Return half of the solid angle of a triangle (3, 3), seen from a point."""
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
def _add_groups(points: Floats, groups: _Groups, found: Floats) -> None:
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
