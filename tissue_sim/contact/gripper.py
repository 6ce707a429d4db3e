"""Gripper: one tool with two jaws that open about a hinge."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from tissue_sim.array_types import Floats
from tissue_sim.contact.quaternions import multiply, rotate

WIDEST = 2.5  # rad; a larger angle must be in another unit


class Jaws(NamedTuple):
    """Dimensions of a gripper.

    Attributes
    ----------
    radius : float, m
        Radius of its jaws, 0 for those of a mesh.
    length : float, m
        Length from the tips to the hinge.
    """

    radius: float
    length: float

    def gap(self, angle: float) -> float:
        """Return the distance between the tips, m.

        Parameters
        ----------
        angle : float, rad
            Angle between the jaws.
        """
        return float(2.0 * (self.radius * np.cos(0.5 * angle) + self.length * np.sin(0.5 * angle) - self.radius))

    def angle(self, gap: float) -> float:
        """Return the angle between the jaws, rad.

        Parameters
        ----------
        gap : float, m
            Distance between the tips.

        Raises
        ------
        ValueError
            If the jaws don't open that wide.
        """
        if not 0.0 <= gap <= self.gap(WIDEST):
            raise ValueError(f"the tips open to {1e3 * self.gap(WIDEST):.3g} mm at most")
        lever = np.hypot(self.radius, self.length)
        return float(2.0 * (np.arcsin((0.5 * gap + self.radius) / lever) - np.arctan2(self.radius, self.length)))


def jaw_poses(pose: Floats, angle: float, radius: float, length: float) -> Floats:
    """Return the poses of a gripper's jaws.

    The gripper's origin lies where the tips of the closed jaws meet, its shaft along -z. The jaws turn about an axis
    along y through the hinge, `length` behind the tips. Each jaw's x axis points away from the other one, and its
    origin lies `radius` from the middle when closed: 0 for jaws of a mesh, whose pads lie in x = 0. Negative angles
    count as closed.

    Parameters
    ----------
    pose : Floats, shape (7,)
        Pose of the gripper, m and unit quaternion xyzw.
    angle : float, rad
        Angle between the jaws.
    radius : float, m
        Radius of the jaws, 0 for those of a mesh.
    length : float, m
        Length from the tips to the hinge.

    Returns
    -------
    Floats, shape (2, 7)
        Poses, m and unit quaternions xyzw.
    """
    half, turn = 0.5 * min(max(angle, 0.0), WIDEST), tuple(pose[3:].tolist())
    sine, cosine = math.sin(half), math.cos(half)
    out, along = cosine * radius + sine * length, cosine * length - sine * radius - length  # of the tips
    poses = np.empty((2, 7))
    for jaw, side in enumerate((1.0, -1.0)):
        poses[jaw, :3] = pose[:3] + rotate(turn, (side * out, 0.0, along))
        opened = multiply(turn, (0.0, side * math.sin(0.5 * half), 0.0, math.cos(0.5 * half)))
        poses[jaw, 3:] = opened if side > 0.0 else multiply(opened, (0.0, 0.0, 1.0, 0.0))  # half a turn about z
    return poses


def about(origin: Floats, wrenches: Floats, origins: Floats) -> Floats:
    """Return the sum of wrenches about one origin.

    Parameters
    ----------
    origin : Floats, shape (3,), m
        Origin of the sum.
    wrenches : Floats, shape (b, 6), N and N m
        Wrenches, each about its own origin.
    origins : Floats, shape (b, 3), m
        Their origins.

    Returns
    -------
    Floats, shape (6,), N and N m
        The sum.
    """
    total = wrenches.sum(axis=0)
    total[3:] += np.cross(origins - origin, wrenches[:, :3]).sum(axis=0)
    return np.asarray(total)
