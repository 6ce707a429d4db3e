"""Pinhole camera: its intrinsics, poses of its optical frame, and the projection for OpenGL.

A camera's pose is that of its optical frame (REP-103): x to the right of the picture, y down, z into it. The centre of
the first pixel has the coordinates 0, 0, as in sensor_msgs/CameraInfo and OpenCV.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from tissue_sim.arguments import finite
from tissue_sim.array_types import Floats
from tissue_sim.errors import UserError

MOST_PIXELS = 4096  # of a side
WIDEST = 150.0  # degrees
AWAY = np.array([0.55, -1.0, 0.3])  # direction from points to the camera that frames them


@dataclass(frozen=True)
class Pinhole:
    """Intrinsics of a camera without distortion.

    Attributes
    ----------
    width, height : int, pixels
        Size of its picture.
    fx, fy : float, pixels
        Focal lengths.
    cx, cy : float, pixels
        Where the optical axis meets the picture.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float

    @classmethod
    def of_view(cls, width: int, height: int, angle: float) -> Pinhole:
        """Return the camera with square pixels and a centred axis that sees an angle across its width.

        Parameters
        ----------
        width, height : int, pixels
            Size of the picture.
        angle : float, degrees
            The angle.

        Raises
        ------
        UserError
            For a size or an angle out of range.
        """
        for side in (width, height):
            if not 16 <= side <= MOST_PIXELS:
                raise UserError(f"a picture of {width} x {height} pixels; both are in 16..{MOST_PIXELS}")
        if not 1.0 <= angle <= WIDEST:
            raise UserError(f"a field of view of {angle:g} degrees is outside 1..{WIDEST:g}")
        focal = 0.5 * width / math.tan(0.5 * math.radians(angle))
        return cls(width, height, focal, focal, 0.5 * (width - 1), 0.5 * (height - 1))

    @property
    def matrix(self) -> Floats:
        """Intrinsic matrix K, shape (3, 3), pixels."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    def project(self, points: Floats) -> Floats:
        """Return where points in front of the camera appear.

        Parameters
        ----------
        points : Floats, shape (n, 3), m
            Positions in the optical frame.

        Returns
        -------
        Floats, shape (n, 2), pixels
            Columns and rows.
        """
        seen = points @ self.matrix.T
        return np.asarray(seen[:, :2] / seen[:, 2:])

    def clip(self, near: float, far: float) -> Floats:
        """Return the matrix (4, 4) from the optical frame to OpenGL's clip coordinates.

        Rows of the picture are upside down in OpenGL, so that the first one in memory is the topmost.

        Parameters
        ----------
        near, far : float, m
            Distances along the axis between which is drawn.
        """
        made = np.zeros((4, 4))
        made[0, 0], made[0, 2] = 2.0 * self.fx / self.width, (2.0 * self.cx + 1.0) / self.width - 1.0
        made[1, 1], made[1, 2] = 2.0 * self.fy / self.height, (2.0 * self.cy + 1.0) / self.height - 1.0
        made[2, 2], made[2, 3] = (far + near) / (far - near), -2.0 * far * near / (far - near)
        made[3, 2] = 1.0
        return made


def matrix_of(pose: ArrayLike) -> Floats:
    """Return a pose as a matrix (4, 4) from its axes to the frame that it is given in.

    Parameters
    ----------
    pose : ArrayLike, shape (7,), m and quaternion xyzw
        The pose.

    Raises
    ------
    UserError
        Where it isn't seven finite numbers with a quaternion that isn't zero.
    """
    numbers = finite(pose, 7, "a pose")
    if not np.linalg.norm(numbers[3:]) > 1e-9:
        raise UserError("a pose's quaternion is zero; give a unit quaternion x, y, z, w")
    made = np.eye(4)
    made[:3, :3], made[:3, 3] = Rotation.from_quat(numbers[3:]).as_matrix(), numbers[:3]
    return made


def inverse_of(matrix: Floats) -> Floats:
    """Return the inverse of a rigid transform's matrix (4, 4)."""
    made = np.eye(4)
    made[:3, :3] = matrix[:3, :3].T
    made[:3, 3] = -made[:3, :3] @ matrix[:3, 3]
    return made


def look_at(position: ArrayLike, target: ArrayLike, up: ArrayLike = (0.0, 0.0, 1.0)) -> Floats:
    """Return the pose of a camera that looks at a point.

    Parameters
    ----------
    position : ArrayLike, shape (3,), m
        Where it stands.
    target : ArrayLike, shape (3,), m
        The point.
    up : ArrayLike, shape (3,), optional
        Direction that is up in its picture.

    Returns
    -------
    Floats, shape (7,), m and quaternion xyzw
        The pose.

    Raises
    ------
    UserError
        Where the two points are the same, or one above the other in that direction.
    """
    eye, goal, upward = finite(position, 3, "position"), finite(target, 3, "target"), finite(up, 3, "up")
    right = np.cross(goal - eye, upward)
    if np.linalg.norm(right) <= 1e-9 * max(np.linalg.norm(goal - eye) * np.linalg.norm(upward), 1e-9):
        raise UserError("the camera stands at its target, or looks along its upward direction; move one of them")
    forward = (goal - eye) / np.linalg.norm(goal - eye)
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(forward, right), forward], axis=1)
    return np.concatenate([eye, Rotation.from_matrix(axes).as_quat()])


def beside(pose: ArrayLike, baseline: float) -> Floats:
    """Return the pose (7,) of a camera moved to its right by so many m: that of the right one of a stereo pair."""
    moved = np.array(finite(pose, 7, "a pose"))
    moved[:3] += baseline * matrix_of(pose)[:3, 0]
    return moved


def framing(points: Floats, lens: Pinhole) -> Floats:
    """Return the pose of a camera that has points in its picture, with a margin.

    Parameters
    ----------
    points : Floats, shape (n, 3), m
        The points.
    lens : Pinhole
        The camera.

    Returns
    -------
    Floats, shape (7,), m and quaternion xyzw
        The pose.
    """
    centre = 0.5 * (points.min(axis=0) + points.max(axis=0))
    radius = float(np.linalg.norm(points - centre, axis=1).max())
    half = math.atan(0.5 * min(lens.width / lens.fx, lens.height / lens.fy))
    return look_at(centre + radius / math.sin(half) * AWAY / np.linalg.norm(AWAY), centre)
