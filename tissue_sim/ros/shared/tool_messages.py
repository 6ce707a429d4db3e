"""The message types that bridges speak on a tool's topics, by the word that a parameter takes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

from geometry_msgs.msg import Pose, PoseStamped, TransformStamped, Wrench, WrenchStamped
from nav_msgs.msg import Odometry
from std_msgs.msg import Float64MultiArray

from tissue_sim.contact.quaternions import Quaternion
from tissue_sim.ros.shared.cdr import Stamped, parse_moving, parse_plain, parse_stamped

N_POSE, N_WRENCH = 7, 6  # numbers in a pose (m, quaternion xyzw) and in a wrench (N, N m)


class Incoming(NamedTuple):
    """A type that comes in: its class, what reads its bytes, and how many numbers it has from the first to its end."""

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
WRENCH_TYPES: dict[str, type] = {
    "WrenchStamped": WrenchStamped,
    "Wrench": Wrench,
    "Float64MultiArray": Float64MultiArray,
}
WRENCH_FRAMES = ("base", "body")


@dataclass(frozen=True)
class ToolTopics:
    """How a bridge speaks: names, types, QoS, frame, and the axes that it takes a wrench along."""

    names: dict[str, str]  # by the topics of TOOL_TOPICS and GRIPPER_TOPICS; empty: off
    frame_id: str
    pose_type: str = "PoseStamped"
    force_type: str = "WrenchStamped"
    wrench_type: str = "WrenchStamped"
    array_length: int = 3
    wrench_frame: str = "base"
    wrench_rotation: Quaternion = (0.0, 0.0, 0.0, 1.0)
    reliable: bool = False
    allow_empty_frame: bool = False  # what has no frame_id is in the one above
    allow_zero_stamp: bool = False  # what has a stamp of 0 is of when it arrived

    @property
    def has_axes_of_its_own(self) -> bool:
        """True when the wrench goes out along axes that no pose has: `wrench_rotation` turns it."""
        return self.wrench_rotation != (0.0, 0.0, 0.0, 1.0)

    @property
    def turns_wrench(self) -> bool:
        """True when the wrench goes out along other axes than the poses come in."""
        return self.wrench_frame == "body" or self.has_axes_of_its_own

    def outgoing(self) -> Any:
        """An empty message of the type that goes out."""
        if self.wrench_type == "Float64MultiArray":
            return Float64MultiArray(data=[0.0] * self.array_length)
        return WRENCH_TYPES[self.wrench_type]()
