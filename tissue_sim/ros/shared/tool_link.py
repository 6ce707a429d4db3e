"""Link to a tool of a running node, by that node's parameters: its topics, its frame, its shape."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from rclpy.qos import QoSProfile

from tissue_sim.contact.tools import Tool
from tissue_sim.json_types import JsonObject
from tissue_sim.ros.shared.frames import Transform
from tissue_sim.ros.shared.messages import NumbersTemplate
from tissue_sim.ros.shared.parameter_values import frames_of, tool_of, topics_of, usual_topics
from tissue_sim.ros.shared.qos import RELIABLE, STREAM
from tissue_sim.ros.shared.tool_messages import POSE_TYPES, ToolTopics


@dataclass(frozen=True)
class ToolLink:
    """What a program beside the node needs to move a tool as its bridge would.

    Attributes
    ----------
    topics : ToolTopics
        Names as the node resolves them, types, QoS.
    to_organ : Transform
        Transform from the frame that poses are sent in to the organ's.
    tool : Tool
        Its shape.
    """

    topics: ToolTopics
    to_organ: Transform
    tool: Tool

    @classmethod
    def by_default(cls, name: str, frame_id: str) -> ToolLink:
        """Return the link of a tool with unknown parameters: poses in the organ's frame, on the usual topics.

        frame_id: frame of the organ.
        """
        return cls(ToolTopics(usual_topics(name), frame_id), Transform(), Tool(name))

    @classmethod
    def from_parameters(cls, values: JsonObject, name: str, target: str) -> ToolLink | None:
        """Return the link by a node's parameters; None when it has no tool of that name."""
        if name not in values.get("tools", ()):
            return None
        topics = topics_of(values, name)
        for topic, given in topics.names.items():
            if given.startswith("~"):  # below the node's own name, not below the asker's
                topics.names[topic] = f"/{target}{given[1:]}"
        return cls(topics, frames_of(values, name, None).to_organ(topics.frame_id), tool_of(values, name))

    @property
    def qos(self) -> QoSProfile:
        """QoS that the node's subscriptions match."""
        return RELIABLE if self.topics.reliable else STREAM

    @property
    def pose_type(self) -> type:
        """Message class of its poses."""
        return POSE_TYPES[self.topics.pose_type].message


class PoseWriter:
    """Bytes of a tool's poses, of the type and in the frame that a link names."""

    def __init__(self, link: ToolLink) -> None:
        message, kind = link.pose_type(), POSE_TYPES[link.topics.pose_type]
        if hasattr(message, "child_frame_id"):
            message.child_frame_id = link.tool.name
        self._template = NumbersTemplate(message, kind.n_numbers, link.topics.frame_id)
        self._scale = link.to_organ.scale
        self._from_organ = link.to_organ.scaled(1.0).inverse()

    def message(self, stamp: int, pose: Sequence[float]) -> bytes:
        """Return the message of a pose (7,) in the organ's frame, m and quaternion xyzw, of a time in ns."""
        x, y, z, *turn = self._from_organ.of(pose)
        return self._template.message(stamp, (x / self._scale, y / self._scale, z / self._scale, *turn))
