"""What a tool's input and its output both know about it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from tissue_sim.array_types import Floats
from tissue_sim.contact.gripper import about
from tissue_sim.contact.quaternions import Vector
from tissue_sim.contact.tools import ToolSet
from tissue_sim.ros.shared.frames import Frames, Placed, Transform, tip_frame, wrench_frame
from tissue_sim.ros.shared.tool_messages import ToolTopics


@dataclass(frozen=True)
class ServedTool:
    """A tool of the node.

    Attributes
    ----------
    index : int
        Its number.
    name : str
        Its name.
    tools : ToolSet
        The set that it belongs to.
    topics : ToolTopics
        Its topics and message types.
    frames : Frames
        Its frames.
    organ_frame : str
        Frame of everything inside the node and in bags.
    """

    index: int
    name: str
    tools: ToolSet
    topics: ToolTopics
    frames: Frames
    organ_frame: str

    @property
    def bodies(self) -> list[int]:
        """Which of all rigid bodies are the tool's: the two jaws of a gripper, the parts of an instrument, or one."""
        return self.tools.bodies[self.index]

    @property
    def has_jaws(self) -> bool:
        """Whether measured_js moves its jaws."""
        return self.tools.tools[self.index].has_jaws

    @property
    def jaw_joint(self) -> str:
        """Name of its jaws' joint in measured_js; empty where the first one counts."""
        return self.tools.tools[self.index].jaw_joint

    @property
    def is_unmoved(self) -> bool:
        """Whether its poses come in the organ's frame, under that name, and are not scaled."""
        topics = self.topics
        return topics.frame_id == self.organ_frame and self.frames.to_organ(topics.frame_id).is_identity

    @property
    def nowhere(self) -> NewestPose:
        """What stands for its newest pose before there is one."""
        pose = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
        to_organ = self.frames.to_organ(self.topics.frame_id)
        return NewestPose(0, pose, np.tile(pose, (len(self.bodies), 1)), self.topics.frame_id, to_organ, b"", b"")

    def axes(self, pose: NewestPose) -> str:
        """Return the frame whose axes the wrench that answers a pose is in."""
        return wrench_frame(self.name) if self.topics.has_axes_of_its_own else self._unturned_axes(pose)

    def _unturned_axes(self, pose: NewestPose) -> str:
        return tip_frame(self.name) if self.topics.wrench_frame == "body" else pose.frame_id

    def moving_frames(self, pose: NewestPose) -> Placed:
        """Return the frames that a pose places: the tip, and the wrench's axes where no other frame has them."""
        found: Placed = {tip_frame(self.name): (self.organ_frame, pose.pose.tolist())}
        if self.topics.has_axes_of_its_own and hasattr(self.topics.outgoing(), "header"):
            found[wrench_frame(self.name)] = (self._unturned_axes(pose), (0.0, 0.0, 0.0, *self.topics.wrench_rotation))
        return found

    def wrench(self, of_bodies: Floats, pose: NewestPose) -> Floats:
        """Return the tool's wrench about its origin.

        of_bodies (B, 6) N and N m: wrenches of all bodies; pose: pose of the tool. Returns (6,) N and N m.
        """
        placed = pose.placed
        if len(self.bodies) == 1 and placed[0, :3].tolist() == pose.pose[:3].tolist():
            return of_bodies[self.bodies[0]]
        return about(pose.pose[:3], of_bodies[self.bodies], placed[:, :3])


class NewestPose(NamedTuple):
    """A pose that was applied, and its bytes for a bag; replaced as a whole, so that its parts belong together."""

    sequence: int
    pose: Floats  # (7,)
    placed: Floats  # (b, 7) of the tool's bodies
    frame_id: str  # that it came in
    to_organ: Transform  # from that frame
    raw: bytes
    angle: bytes  # of a gripper


def turned(wrench: Sequence[float], turn: Callable[[Vector], Vector]) -> tuple[float, ...]:
    """Return a wrench (6,) with its force and its torque rotated by `turn`."""
    fx, fy, fz, tx, ty, tz = wrench
    return (*turn((fx, fy, fz)), *turn((tx, ty, tz)))
