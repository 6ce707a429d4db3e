"""Poses of rigid bodies: (7,) m and unit quaternion xyzw."""

from __future__ import annotations

import math

from tissue_sim.array_types import Floats
from tissue_sim.jit import kernel
from tissue_sim.model.contact.shapes import rotation_matrix
from tissue_sim.model.data.arrays import copy


@kernel
def distance_along_path(pose: Floats, other: Floats, extent: float) -> float:
    """Return a bound on the distance between the same points of a body in two poses.

    Parameters
    ----------
    pose, other : Floats, shape (7,)
        The poses.
    extent : float, m
        Largest distance of its points from its origin.

    Returns
    -------
    float, m
        The distance.
    """
    if extent == 0.0:
        return distance(pose, other)
    # A chord between unit quaternions is 2 sin(angle / 4), and a point moves by 2 sin(angle / 2) of its arm.
    return distance(pose, other) + 2.0 * extent * quaternion_distance(pose, other)


@kernel
def distance(pose: Floats, other: Floats) -> float:
    """Return the distance between the origins of two poses.

    Parameters
    ----------
    pose, other : Floats, shape (7,)
        The poses.

    Returns
    -------
    float, m
        The distance.
    """
    return math.sqrt((pose[0] - other[0]) ** 2 + (pose[1] - other[1]) ** 2 + (pose[2] - other[2]) ** 2)


@kernel
def quaternion_distance(pose: Floats, other: Floats) -> float:
    """Return the chord between the quaternions of two poses, of either sign: half the angle where it is small.

    Parameters
    ----------
    pose, other : Floats, shape (7,)
        The poses.
    """
    less = more = 0.0
    for c in range(3, 7):
        less += (pose[c] - other[c]) ** 2
        more += (pose[c] + other[c]) ** 2
    return math.sqrt(min(less, more))


@kernel
def step_pose(pose: Floats, goal: Floats, fraction: float) -> None:
    """Move a pose (7,) by a fraction of the distance to a goal; the quaternion by normalised linear interpolation."""
    if fraction >= 1.0:
        copy(goal, pose)
        return
    for c in range(3):
        pose[c] += fraction * (goal[c] - pose[c])
    dot = pose[3] * goal[3] + pose[4] * goal[4] + pose[5] * goal[5] + pose[6] * goal[6]
    sign = 1.0 if dot >= 0.0 else -1.0
    norm = 0.0
    for c in range(3, 7):
        pose[c] += fraction * (sign * goal[c] - pose[c])
        norm += pose[c] * pose[c]
    norm = 1.0 / math.sqrt(norm)
    for c in range(3, 7):
        pose[c] *= norm


@kernel
def set_frame(pose: Floats, origin: Floats, rotation: Floats) -> None:
    """Write the origin and the rotation matrix of a pose.

    Parameters
    ----------
    pose : Floats, shape (7,), m and quaternion xyzw
        The pose.
    origin : Floats, shape (3,), m
        Its origin; updated.
    rotation : Floats, shape (9,)
        Its rotation matrix, row by row; updated.
    """
    copy(pose[:3], origin)
    rotation_matrix(pose[3:], rotation)
