"""Publishing of the tools at the marker rate: as markers, and to tf."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence

from rclpy.node import Node
from visualization_msgs.msg import MarkerArray

from tissue_sim.contact.tools import ToolSet
from tissue_sim.ros.node.output.organ_publisher import REPEAT_AFTER
from tissue_sim.ros.node.output.published_shapes import Touches
from tissue_sim.ros.node.output.tf_broadcast import TfBroadcast
from tissue_sim.ros.node.output.tool_markers import ToolMarkers
from tissue_sim.ros.node.tools.tool_port import ToolPort
from tissue_sim.ros.shared.frames import Placed
from tissue_sim.ros.shared.organs import Organs
from tissue_sim.ros.shared.qos import RELIABLE

POSE_LASTS = 1.0  # s that a tool is shown without a new pose


class ToolPublisher:
    """Publisher of where the tools are, and what they feel of all organs."""

    def __init__(
        self,
        node: Node,
        frame_id: str,
        organs: Organs,
        ports: Sequence[ToolPort],
        tools: ToolSet,
        broadcast: TfBroadcast | None,
    ) -> None:
        self._ports, self._touches, self._clock = list(ports), Touches(ports, organs), node.get_clock()
        self._broadcast, self._tips_sent = broadcast, [0] * len(self._ports)
        self._tools = node.create_publisher(MarkerArray, "~/tools", RELIABLE)
        self._bytes = ToolMarkers(frame_id, tools)
        self._shown: tuple[object, ...] = ()
        self._sent = -math.inf

    def present(self) -> None:
        """Publish where the tools are, if there are subscribers and they have moved or feel something else."""
        if self._tools.get_subscription_count() == 0:
            return
        now = time.monotonic()
        newest = [port.newest for port in self._ports]
        fresh = [port.pose_freshness.age < POSE_LASTS for port in self._ports]
        tips, wrenches = self._touches.now()
        forces = wrenches[:, :3]
        shown = (*(pose.sequence for pose in newest), *fresh, forces.tobytes())
        if shown == self._shown and now - self._sent < REPEAT_AFTER:
            return
        self._shown, self._sent = shown, now
        placed = [pose.placed if is_fresh else None for pose, is_fresh in zip(newest, fresh, strict=True)]
        self._tools.publish(self._bytes.message(self._clock.now().nanoseconds, placed, tips, forces))

    def broadcast_tips(self) -> None:
        """Publish the tips of tools with a new pose on tf."""
        if self._broadcast is None:
            return
        newest = [port.newest for port in self._ports]
        placed: Placed = {}
        for port, pose, sent in zip(self._ports, newest, self._tips_sent, strict=True):
            if pose.sequence != sent:
                placed |= port.moving_frames(pose)
        self._tips_sent = [pose.sequence for pose in newest]
        self._broadcast.move(self._clock.now().nanoseconds, placed)

    def close(self) -> None:
        """Delete the markers in every viewer."""
        self._tools.publish(self._bytes.deletion())
