"""Where a camera is: a pose that was given, that a topic brings, or that of a frame in tf."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Protocol

import numpy as np
from geometry_msgs.msg import PoseStamped
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

from tissue_sim.array_types import Floats
from tissue_sim.errors import UserError
from tissue_sim.rendering.pinhole import Pinhole, framing
from tissue_sim.ros.node.input.tf_lookup import TfLookup, tf_installed
from tissue_sim.ros.shared import client
from tissue_sim.ros.shared.cdr import check_position, unit_pose
from tissue_sim.ros.shared.frames import Frames, Transform, UnknownFrame
from tissue_sim.ros.shared.parameter_values import Values, frames_of_node

# Axes of a pose: those of an optical frame are x right, y down, z forward; those of a body x forward, y left, z up
# (REP-103).
AXES = {"optical": Transform(), "body": Transform(rotation=(-0.5, 0.5, -0.5, 0.5))}


class Viewpoint(Protocol):
    """A source of a camera's pose."""

    def use(self, values: Values) -> None:
        """Use the parameters of the node, by name, for the frames that they place."""

    def pose(self, points: Floats) -> Floats | None:
        """Return the pose (7,), m and quaternion xyzw, in the organ's frame; None while it is unknown.

        points (n, 3) m: points of the organs at rest.
        """


class Fixed:
    """A pose (7,) in the organ's frame; without one, that from which the organs fill the picture."""

    def __init__(self, lens: Pinhole, pose: Floats | None = None) -> None:
        self._lens, self._pose = lens, pose

    def use(self, values: Values) -> None:
        """Do nothing: it is given in the organ's frame."""

    def pose(self, points: Floats) -> Floats | None:
        """Return the pose."""
        return framing(points, self._lens) if self._pose is None else self._pose


class FromTopic:
    """The newest pose of a topic, in the organ's frame, in `base_frame`, or in one that tf knows.

    topic: topic of a PoseStamped; warn: takes a line about a pose that can't be used.
    """

    def __init__(self, node: Node, topic: str, axes: Transform, warn: Callable[[str], object]) -> None:
        self._inbox = client.NewestMessage(node, PoseStamped, topic, client.stream_qos())
        self._node, self._axes, self._warn = node, axes, warn
        self._frames: Frames | None = None
        self._organ_frame, self._said = "", ""
        self._given: PoseStamped | None = None  # the newest message, which is placed again for every picture

    def use(self, values: Values) -> None:
        """Use the parameters of the node, by name, for the frames that they place."""
        lookup = TfThread.beside(self._node, values) if tf_installed() else None
        self._frames, self._organ_frame = frames_of_node(values, lookup), values["frame_id"]

    def pose(self, points: Floats) -> Floats | None:
        """Return the newest pose; None where it can't be used."""
        self._given = self._inbox.take() or self._given
        if self._given is None or self._frames is None:
            return None
        frame_id = self._given.header.frame_id or self._organ_frame
        try:
            return _placed(self._frames.to_organ(frame_id).after(Transform.of_pose(_checked(self._given))), self._axes)
        except (ValueError, UnknownFrame) as error:
            line = f"no pictures: the camera's pose in frame '{frame_id}' can't be used: {error}"
            if line != self._said:
                self._warn(line)
            self._said = line
            return None


class FromTf:
    """The pose of a frame in tf. node: the node that subscribes. Raises UserError where tf2_ros is not installed."""

    def __init__(self, node: Node, frame_id: str, axes: Transform) -> None:
        if not tf_installed():
            raise UserError("--tf needs tf2_ros, which is not installed: apt install ros-jazzy-tf2-ros-py")
        self._node, self._frame_id, self._axes = node, frame_id, axes
        self._frames: Frames | None = None

    def use(self, values: Values) -> None:
        """Use the parameters of the node, by name, for the frames that they place."""
        self._frames = frames_of_node(values, TfThread.beside(self._node, values))

    def pose(self, points: Floats) -> Floats | None:
        """Return its pose; None while tf doesn't know it."""
        if self._frames is None:
            return None
        try:
            return _placed(self._frames.to_organ(self._frame_id), self._axes)
        except UnknownFrame:
            return None


class TfThread(TfLookup):
    """Lookup of frames whose node is spun by a thread of its own, as nothing spins that of a client."""

    def __init__(self, node: Node, target: str) -> None:
        super().__init__(node, target)
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        threading.Thread(target=executor.spin, daemon=True).start()

    @classmethod
    def beside(cls, client_node: Node, values: Values) -> TfThread:
        """Return a lookup of a client, against the frame that a node's parameters place the organ in."""
        return cls(client.node_beside(client_node, "tf"), values["base_frame"] or values["frame_id"])


def _placed(frame: Transform, axes: Transform) -> Floats:
    """Return the pose (7,) of an optical frame whose axes are those in a frame, led to the organ."""
    optical = frame.after(axes)
    return np.array([*optical.translation, *optical.rotation])


def _checked(message: PoseStamped) -> list[float]:
    """Return the pose (7,) of a message; raise ValueError for one that is invalid, or in another unit."""
    place, turn = message.pose.position, message.pose.orientation
    pose = np.array([place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w])
    if not np.isfinite(pose).all():
        raise ValueError("it isn't seven finite numbers")
    check_position(pose[:3])
    return unit_pose(pose).tolist()
