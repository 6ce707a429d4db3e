"""Frames of a tool's poses: rigid transforms between its frame and the organ's, fixed or looked up."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

from tissue_sim.contact.quaternions import Quaternion, Vector, multiply, rotate, unit_quaternion

IDENTITY = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)


def tip_frame(tool: str) -> str:
    """Return the frame at a tool's tip, its origin, along the tool's own axes."""
    return f"{tool}_tip"


def wrench_frame(tool: str) -> str:
    """Return the frame of a tool's wrench where `wrench_rotation` turns that away from every other frame."""
    return f"{tool}_wrench"


class UnknownFrame(ValueError):
    """A frame without a transform to the organ; the message is the end of a sentence that names the frame."""


class Transform(NamedTuple):
    """A rigid transform.

    Plain floats, because it runs for each pose at up to 1 kHz, where small arrays would cost more.

    Attributes
    ----------
    translation : Vector, shape (3,), m
        Its translation.
    rotation : Quaternion, shape (4,)
        Its unit quaternion xyzw.
    scale : float
        Factor on positions before it: m of the tool for one m of the hand.
    """

    translation: Vector = (0.0, 0.0, 0.0)
    rotation: Quaternion = (0.0, 0.0, 0.0, 1.0)
    scale: float = 1.0

    @classmethod
    def of_pose(cls, pose: Sequence[float]) -> Transform:
        """Return the transform of a pose: from the axes at that pose to the frame it is given in.

        pose (7,) m and quaternion xyzw. Raises ValueError when it isn't seven finite numbers with a quaternion that
        isn't zero.
        """
        if len(pose) != 7 or not all(map(math.isfinite, pose)):
            raise ValueError("must be seven finite numbers: x, y, z (m) and a quaternion x, y, z, w")
        x, y, z = (float(value) for value in pose[:3])
        return cls((x, y, z), unit_quaternion(pose[3:]))

    @property
    def is_identity(self) -> bool:
        """Whether it changes no pose."""
        return self == UNMOVED

    def inverse(self) -> Transform:
        """Return the transform back; of a transform without scale."""
        x, y, z, w = self.rotation
        back = (-x, -y, -z, w)
        tx, ty, tz = rotate(back, self.translation)
        return Transform((-tx, -ty, -tz), back)

    def after(self, first: Transform) -> Transform:
        """Return this transform after another one; only the first one may have a scale."""
        x, y, z = rotate(self.rotation, first.translation)
        tx, ty, tz = self.translation
        return Transform((tx + x, ty + y, tz + z), multiply(self.rotation, first.rotation), first.scale)

    def scaled(self, scale: float) -> Transform:
        """Return this transform, with positions scaled by a factor before it."""
        return Transform(self.translation, self.rotation, scale)

    def of(self, pose: Sequence[float]) -> tuple[float, ...]:
        """Return a transformed pose (7,), m and quaternion xyzw; a quaternion keeps its length."""
        px, py, pz, qx, qy, qz, qw = pose
        scale = self.scale
        x, y, z = rotate(self.rotation, (scale * px, scale * py, scale * pz))
        tx, ty, tz = self.translation
        return (tx + x, ty + y, tz + z, *multiply(self.rotation, (qx, qy, qz, qw)))


UNMOVED = Transform()


# Frames by name, each with its parent and its pose (7,) in that, m and quaternion xyzw.
Placed = dict[str, tuple[str, Sequence[float]]]


class Frames:
    """Transforms to the organ from the frames that a tool's poses may come in.

    known: from each frame to the organ's; scale: factor on positions; lookup: called for any other frame, raises
    UnknownFrame, None without tf.
    """

    def __init__(
        self, known: dict[str, Transform], scale: float = 1.0, lookup: Callable[[str], Transform] | None = None
    ) -> None:
        self._known = {frame_id: transform.scaled(scale) for frame_id, transform in known.items()}
        self._scale, self._lookup = scale, lookup

    def become(self, other: Frames) -> None:
        """Take over the transforms of other frames."""
        self._known, self._scale, self._lookup = other._known, other._scale, other._lookup

    def to_organ(self, frame_id: str) -> Transform:
        """Return the transform from a frame to the organ's. Raises UnknownFrame when there is none."""
        transform = self._known.get(frame_id)
        if transform is not None:
            return transform
        if self._lookup is None:
            raise UnknownFrame("tf2_ros, which could look up other frames, isn't installed")
        return self._lookup(frame_id).scaled(self._scale)
