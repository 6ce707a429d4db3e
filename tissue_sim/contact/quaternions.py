"""Unit quaternions xyzw of plain floats, with the same additions and products on every processor.

Small arrays would be slower, and SciPy's rotations differ in the last bits between processors, unlike a replay.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]


def unit_quaternion(values: Sequence[float]) -> Quaternion:
    """Return a quaternion scaled to length 1.

    Parameters
    ----------
    values : Sequence[float], xyzw
        The quaternion.

    Returns
    -------
    Quaternion
        Unit quaternion xyzw.

    Raises
    ------
    ValueError
        Where it is zero or isn't four finite numbers.
    """
    if len(values) != 4 or not all(map(math.isfinite, values)):
        raise ValueError("must be a quaternion of four finite numbers: x, y, z, w")
    length = math.hypot(*values)
    if length < 1e-6:
        raise ValueError("has a zero quaternion; the identity is 0, 0, 0, 1")
    x, y, z, w = (float(value) / length for value in values)
    return (x, y, z, w)


def multiply(first: Quaternion, second: Quaternion) -> Quaternion:
    """Return the rotation `first` after `second`.

    Parameters
    ----------
    first, second : Quaternion, xyzw
        Unit quaternions.

    Returns
    -------
    Quaternion
        Unit quaternion xyzw.
    """
    ax, ay, az, aw = first
    bx, by, bz, bw = second
    return (
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    )


def rotate(rotation: Quaternion, vector: Vector) -> Vector:
    """Return a vector turned by a rotation.

    Parameters
    ----------
    rotation : Quaternion, xyzw
        Unit quaternion.
    vector : Vector
        The vector.
    """
    x, y, z, w = rotation
    vx, vy, vz = vector
    cx, cy, cz = y * vz - z * vy + w * vx, z * vx - x * vz + w * vy, x * vy - y * vx + w * vz
    return (vx + 2.0 * (y * cz - z * cy), vy + 2.0 * (z * cx - x * cz), vz + 2.0 * (x * cy - y * cx))


def rotate_back(rotation: Quaternion, vector: Vector) -> Vector:
    """Return a vector turned by the inverse of a rotation.

    Parameters
    ----------
    rotation : Quaternion, xyzw
        Unit quaternion.
    vector : Vector
        The vector.
    """
    x, y, z, w = rotation
    return rotate((-x, -y, -z, w), vector)
