"""One tool of the scripted bridge: its topics, as a haptic device has them."""

from __future__ import annotations

from collections.abc import Sequence

from rclpy.node import Node
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from tissue_sim.array_types import Floats
from tissue_sim.ros.shared.client import NewestMessage
from tissue_sim.ros.shared.tool_link import PoseWriter, ToolLink
from tissue_sim.ros.shared.tool_messages import FORCE_TYPES, N_WRENCH, WRENCH_TYPES


class ScriptedTool:
    """Sender of poses, and of the angle between jaws if there are any, and receiver of wrenches."""

    def __init__(self, node: Node, link: ToolLink, has_jaws: bool = False) -> None:
        topics = link.topics
        self._node, self.name, self.topic = node, link.tool.name, topics.names["measured_cp"]
        self._writer = PoseWriter(link)
        self._publisher = node.create_publisher(link.pose_type, self.topic, link.qos)
        self._joint = JointState(name=["jaw"], position=[0.0])
        self._jaws = node.create_publisher(JointState, topics.names["measured_js"], link.qos) if has_jaws else None
        self._wrench_type = topics.wrench_type
        kind = WRENCH_TYPES[topics.wrench_type]
        self._wrenches: NewestMessage[bytes] = NewestMessage(node, kind, topics.names["servo_cf"], link.qos, raw=True)
        self.sent = self.received = 0
        self.peak = 0.0  # N, largest force so far

    def renew(self, link: ToolLink) -> None:
        """Lead the poses that follow to where the organ is now, by a link of the same topics."""
        self._writer = PoseWriter(link)

    def publish(self, stamp: int, pose: Floats) -> None:
        """Send a pose (7,) in the organ's frame, m and quaternion xyzw, of a time in ns."""
        self._publisher.publish(self._writer.message(stamp, pose.tolist()))
        self.sent += 1

    def open(self, stamp: int, angle: float) -> None:
        """Send the angle between the jaws, rad, of a time in ns; nothing for a tool without jaws."""
        if self._jaws is None:
            return
        self._joint.header.stamp.sec, self._joint.header.stamp.nanosec = divmod(stamp, 1_000_000_000)
        self._joint.position[0] = angle
        self._jaws.publish(self._joint)

    @property
    def has_subscribers(self) -> bool:
        """Whether the poses have a subscriber, and to the jaws if there are any."""
        publishers = [self._publisher] if self._jaws is None else [self._publisher, self._jaws]
        return all(publisher.get_subscription_count() for publisher in publishers)

    def other_publishers(self) -> int:
        """Return how many others publish the tool's poses."""
        return int(self._node.count_publishers(self.topic)) - 1

    def receive(self) -> None:
        """Take the newest wrench, if one has come."""
        raw = self._wrenches.take()
        if raw is not None:
            x, y, z = self._force(raw)
            self.peak = max(self.peak, (x * x + y * y + z * z) ** 0.5)
            self.received += 1

    def _force(self, raw: bytes) -> Sequence[float]:
        if self._wrench_type in FORCE_TYPES:
            return FORCE_TYPES[self._wrench_type].parse(raw, N_WRENCH).values[:3]
        return tuple(deserialize_message(raw, Float64MultiArray).data[:3])
