"""Message types of bridges on a tool's topics, by the value of a parameter."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

from geometry_msgs.msg import Pose, PoseStamped, TransformStamped, Wrench, WrenchStamped
from nav_msgs.msg import Odometry
from std_msgs.msg import Float64MultiArray

from tissue_sim.contact.quaternions import Quaternion
from tissue_sim.ros.shared.cdr import Stamped, parse_moving, parse_plain, parse_stamped

N_POSE, N_WRENCH = 7, 6  # numbers in a pose (m, quaternion xyzw) and in a wrench (N, N m)


class Incoming(NamedTuple):
    """A type of received messages: its class, its parser, and how many numbers it has from the first to its end."""

    message: type
    parse: Callable[[bytes, int], Stamped]
    n_numbers: int


POSE_TYPES = {
    "PoseStamped": Incoming(PoseStamped, parse_stamped, N_POSE),
    "Pose": Incoming(Pose, parse_plain, N_POSE),
    "TransformStamped": Incoming(TransformStamped, parse_moving, N_POSE),
    "Odometry": Incoming(Odometry, parse_moving, N_POSE + 36 + 6 + 36),
}
FORCE_TYPES = {
    "WrenchStamped": Incoming(WrenchStamped, parse_stamped, N_WRENCH),
    "Wrench": Incoming(Wrench, parse_plain, N_WRENCH),
}
type WrenchMessage = WrenchStamped | Wrench | Float64MultiArray
WRENCH_TYPES: dict[str, type] = {
    "WrenchStamped": WrenchStamped,
    "Wrench": Wrench,
    "Float64MultiArray": Float64MultiArray,
}
WRENCH_FRAMES = ("base", "body")


@dataclass(frozen=True)
class ToolTopics:
    """Topics of a bridge: names, types, QoS, frame, and the axes of its wrenches."""

    names: dict[str, str]  # by the topics of TOOL_TOPICS and GRIPPER_TOPICS; empty: off
    frame_id: str
    pose_type: str = "PoseStamped"
    force_type: str = "WrenchStamped"
    wrench_type: str = "WrenchStamped"
    array_length: int = 3
    wrench_frame: str = "base"
    wrench_rotation: Quaternion = (0.0, 0.0, 0.0, 1.0)
    reliable: bool = False
    allow_empty_frame: bool = False  # messages without frame_id are in the one above
    allow_zero_stamp: bool = False  # messages with stamp 0 count from their arrival

    @property
    def has_axes_of_its_own(self) -> bool:
        """Whether `wrench_rotation` turns the wrench to axes that no pose has."""
        return self.wrench_rotation != (0.0, 0.0, 0.0, 1.0)

    @property
    def turns_wrench(self) -> bool:
        """Whether the wrench is published along other axes than those of the poses."""
        return self.wrench_frame == "body" or self.has_axes_of_its_own

    def outgoing(self) -> WrenchMessage:
        """Return an empty message of the published type."""
        if self.wrench_type == "Float64MultiArray":
            return Float64MultiArray(data=[0.0] * self.array_length)
        return WRENCH_TYPES[self.wrench_type]()
