"""Frames of organ and tools on tf, where tf2_ros is installed (apt), so that RViz shows them in any frame."""

from __future__ import annotations

from collections.abc import Sequence

from geometry_msgs.msg import TransformStamped
from rclpy.node import Node
from rclpy.time import Time

from tissue_sim.ros.shared.frames import Placed


class TfBroadcast:
    """Broadcaster of the frames that parameters place, latched, and of those that move.

    To be made only where tf_installed().
    """

    def __init__(self, node: Node) -> None:
        import tf2_ros

        self._static = tf2_ros.StaticTransformBroadcaster(node)
        self._moving = tf2_ros.TransformBroadcaster(node)

    def fix(self, stamp: int, placed: Placed) -> None:
        """Broadcast static frames. stamp: their time, ns; placed: the frames."""
        if placed:
            self._static.sendTransform(_messages(stamp, placed))

    def move(self, stamp: int, placed: Placed) -> None:
        """Broadcast moving frames. stamp: their time, ns; placed: the frames."""
        if placed:
            self._moving.sendTransform(_messages(stamp, placed))


def _messages(stamp: int, placed: Placed) -> list[TransformStamped]:
    return [transform_message(stamp, parent, child, pose) for child, (parent, pose) in placed.items()]


def transform_message(stamp: int, parent: str, child: str, pose: Sequence[float]) -> TransformStamped:
    """Return a frame at a pose (7,) in its parent, as tf2_ros takes it; stamp in ns."""
    message = TransformStamped(child_frame_id=child)
    message.header.frame_id, message.header.stamp = parent, Time(nanoseconds=stamp).to_msg()
    offset, turn = message.transform.translation, message.transform.rotation
    offset.x, offset.y, offset.z, turn.x, turn.y, turn.z, turn.w = map(float, pose)
    return message
