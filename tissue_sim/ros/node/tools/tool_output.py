"""Output of a tool's wrench: of its bridge's type, along its axes, until it has faded."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Sequence

import numpy as np
from geometry_msgs.msg import WrenchStamped
from rclpy.node import Node

from tissue_sim.array_types import Floats
from tissue_sim.contact.quaternions import rotate_back
from tissue_sim.ros.bags.recorder import Recorder
from tissue_sim.ros.node.shared.served_tool import NewestPose, ServedTool, turned
from tissue_sim.ros.node.tools.passivity import DevicePort
from tissue_sim.ros.shared.messages import NumbersTemplate
from tissue_sim.ros.shared.organs import Organs
from tissue_sim.ros.shared.qos import RELIABLE, STREAM
from tissue_sim.ros.shared.tool_messages import N_WRENCH


class ToolOutput:
    """Output of a tool's servo_cf, and of the tissue's wrench on it in the organ's frame, which a bag holds.

    A wrench is published in answer to each pose, from that pose's own callback; `keep_publishing` goes on at the tick
    rate when poses stop, until the wrench is zero.
    """

    device: DevicePort  # may damp a force on its way out; the node sets it

    def __init__(self, node: Node, tool: ServedTool, organs: Organs, recorder: Recorder) -> None:
        self._tool, self._organs, self._recorder = tool, organs, recorder
        self._clock = node.get_clock()
        self._pose = tool.nowhere  # the last one that was answered
        self.force = 0.0  # N, magnitude last published
        self.not_finite = 0  # wrenches that were zeroed
        topics = tool.topics
        self._axes, self._template = "", self._template_for("")
        self._bag_wrench = NumbersTemplate(WrenchStamped(), N_WRENCH, tool.organ_frame)
        self._in_organ_frame = node.create_publisher(WrenchStamped, f"~/{tool.name}/wrench", RELIABLE)
        self._lock = threading.Lock()
        self._published = -math.inf  # monotonic s
        qos = RELIABLE if topics.reliable else STREAM
        self._servo = node.create_publisher(type(topics.outgoing()), topics.names["servo_cf"], qos)
        # Bytes that are published just as a bag holds them are not made a second time.
        self._as_bagged = tool.is_unmoved and topics.wrench_type == "WrenchStamped" and not topics.turns_wrench
        name = self._servo.topic_name if self._as_bagged else ""
        self._bagged = recorder.add_topic(tool.name, "servo_cf", name, qos)

    def answer(self, pose: NewestPose) -> None:
        """Publish the newest wrench, in answer to a pose."""
        with self._lock:
            self._pose = pose
            tick, wrench = self._newest()
            self._send(tick, wrench, self.device.passive_wrench(pose.pose[:3], wrench))

    def renew(self, pose: NewestPose) -> None:
        """Use the frames of the newest pose."""
        with self._lock:
            self._pose = pose

    def keep_publishing(self, silence: float) -> bool:
        """Publish the newest wrench if none was published for a while and the last one wasn't zero.

        silence: that while, s. Returns True while something is left to fade.
        """
        with self._lock:
            if self.force == 0.0:
                return False
            if time.monotonic() - self._published >= max(silence, self.device.patience):
                self.device.forget()
                tick, wrench = self._newest()
                self._send(tick, wrench, wrench)
            return self.force != 0.0

    def publish_zero(self) -> None:
        """Publish a last wrench of zero, for the shutdown."""
        with self._lock:
            self._send(-1, np.zeros(6), np.zeros(6))

    def _newest(self) -> tuple[int, Floats]:
        """Return the newest tick, and the tool's wrench (6,) of it."""
        tick, wrenches = self._organs.wrenches()
        return tick, self._tool.wrench(wrenches, self._pose)

    def _send(self, tick: int, wrench: Floats, output: Floats) -> None:
        """Publish what a hand is to feel; a bag holds the wrench of the tick, which a replay repeats."""
        if not all(map(math.isfinite, output.tolist())):  # has not occurred yet, and must never reach a hand
            wrench = output = np.zeros(6)
            self.not_finite += 1
        stamp = self._clock.now().nanoseconds
        if (axes := self._tool.axes(self._pose)) != self._axes:
            self._axes, self._template = axes, self._template_for(axes)
        raw = self._template.message(stamp, self._along_axes(output))
        self._servo.publish(raw)
        if self._in_organ_frame.get_subscription_count() > 0:
            self._in_organ_frame.publish(self._bag_wrench.message(stamp, wrench))
        self.force = math.sqrt(float(output[:3] @ output[:3]))
        self._published = time.monotonic()
        if self._recorder.active:
            is_in_organ_frame = self._axes == self._tool.organ_frame and self._pose.to_organ.is_identity
            if not (self._as_bagged and is_in_organ_frame and output is wrench):
                raw = self._bag_wrench.message(stamp, wrench)
            self._recorder.wrench(self._bagged, self._tool.index, tick, raw)

    def _template_for(self, axes: str) -> NumbersTemplate:
        """Return a message whose numbers are along the axes of a frame."""
        topics = self._tool.topics
        n_numbers = topics.array_length if topics.wrench_type == "Float64MultiArray" else N_WRENCH
        return NumbersTemplate(topics.outgoing(), n_numbers, axes)

    def _along_axes(self, wrench: Floats) -> Sequence[float] | Floats:
        """Return a wrench in the organ's axes along those that the bridge expects; still about the tool's origin."""
        pose, topics = self._pose, self._tool.topics
        if pose.to_organ.is_identity and not topics.turns_wrench:
            return wrench
        x, y, z, w = pose.pose.tolist()[3:] if topics.wrench_frame == "body" else pose.to_organ.rotation
        turn = topics.wrench_rotation
        return turned(wrench.tolist(), lambda v: rotate_back(turn, rotate_back((x, y, z, w), v)))
