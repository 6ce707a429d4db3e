"""Where organ and tools are, told to tf where tf2_ros is installed (apt): RViz shows them in any frame then."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from geometry_msgs.msg import TransformStamped
from rclpy.node import Node
from rclpy.time import Time

from tissue_sim.array_types import Floats
from tissue_sim.ros.shared.frames import Transform


def tip_frame(tool: str) -> str:
    """The frame at a tool's tip, its origin, along the tool's own axes."""
    return f"{tool}_tip"


class TfBroadcast:
    """Broadcasts the frames that parameters place, once and latched; the tools' tips as they move.

    placed: for each frame its parent and the transform to that. To be made where tf_installed() alone.
    """

    def __init__(
        self, node: Node, organ_frame: str, tools: Sequence[str], placed: dict[str, tuple[str, Transform]]
    ) -> None:
        import tf2_ros

        self._organ_frame, self._tips = organ_frame, [tip_frame(tool) for tool in tools]
        self._static = tf2_ros.StaticTransformBroadcaster(node)
        self._moving = tf2_ros.TransformBroadcaster(node)
        now = node.get_clock().now().nanoseconds
        messages = [
            transform_message(now, parent, child, (*transform.translation, *transform.rotation))
            for child, (parent, transform) in placed.items()
        ]
        if messages:
            self._static.sendTransform(messages)

    def tips(self, stamp: int, poses: Sequence[Floats | None]) -> None:
        """Broadcast the tips for a stamp in ns: poses (7,) in the organ's frame, or None for one that did not move."""
        messages = [
            transform_message(stamp, self._organ_frame, tip, pose.tolist())
            for tip, pose in zip(self._tips, poses, strict=True)
            if pose is not None
        ]
        if messages:
            self._moving.sendTransform(messages)


def transform_message(stamp: int, parent: str, child: str, pose: Sequence[float]) -> Any:
    """A frame at a pose (7,) in its parent, as tf2_ros takes it; stamp in ns."""
    message = TransformStamped(child_frame_id=child)
    message.header.frame_id, message.header.stamp = parent, Time(nanoseconds=stamp).to_msg()
    offset, turn = message.transform.translation, message.transform.rotation
    offset.x, offset.y, offset.z, turn.x, turn.y, turn.z, turn.w = map(float, pose)
    return message
