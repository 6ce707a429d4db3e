"""A tool that somebody without a haptic device holds: its pose follows a goal, and is published while it is held."""

from __future__ import annotations

import threading
import time

import numpy as np
from rclpy.node import Node
from rclpy.publisher import Publisher

from tissue_sim.array_types import Floats
from tissue_sim.ros.shared.tool_link import PoseWriter, ToolLink

RATE = 250.0  # Hz, of the poses
TOP_SPEED = 0.2  # m/s: a jerk of the mouse is no blow
RISE_TIME = 0.05  # s in which the tool covers most of a short way
ACCELERATION = TOP_SPEED / RISE_TIME  # m/s^2
LONGEST_STEP = 0.02  # s: a thread that was held up goes on from where it was, it doesn't leap


def follow(position: Floats, velocity: Floats, goal: Floats, step: float) -> tuple[Floats, Floats]:
    """One step of `step` s towards a goal (3,) m: the new position m and velocity m/s.

    No faster than TOP_SPEED, without a jump in speed, and without shooting past a goal that stands still.
    """
    wanted = (goal - position) / max(RISE_TIME, 2.0 * step)
    velocity = velocity + limited(limited(wanted, TOP_SPEED) - velocity, ACCELERATION * step)
    return position + step * velocity, velocity


def limited(vector: Floats, length: float) -> Floats:
    """The vector, cut to a length."""
    size = float(np.linalg.norm(vector))
    return vector if size <= length else vector * (length / size)


class HeldTool:
    """Publishes a tool's poses from a thread of its own, between `take` and `release`.

    The thread keeps poses coming while the viewer is busy with a picture, so that none gets stale.
    """

    def __init__(self, node: Node, name: str) -> None:
        self._node, self._name = node, name
        self._link: ToolLink | None = None
        self._publisher: Publisher | None = None
        self._thread: threading.Thread | None = None
        self._released = threading.Event()
        self.goal: Floats = np.zeros(3)  # m in the organ's frame; replaced as a whole, from any thread

    def use(self, link: ToolLink) -> None:
        """Speak to the tool like this from now on; one that is held otherwise is let go."""
        if link != self._link:
            self.release()
            self._link = link

    @property
    def topic(self) -> str:
        """Where the poses go."""
        return (self._link or ToolLink.by_default(self._name, "")).topics.names["measured_cp"]

    @property
    def held(self) -> bool:
        """True between `take` and `release`."""
        return self._thread is not None

    def rivals(self) -> int:
        """How many others publish the tool's poses."""
        return int(self._node.count_publishers(self.topic)) - (1 if self.held else 0)

    def take(self, position: Floats, quaternion: Floats, frame_id: str) -> None:
        """Hold the tool at a position (3,) m with a quaternion (4,) x y z w in the organ's frame, until `release`."""
        self.release()
        self.goal = np.array(position, dtype=np.float64)
        link = self._link or ToolLink.by_default(self._name, frame_id)
        self._publisher = self._node.create_publisher(link.pose_type, self.topic, link.qos)
        self._released.clear()
        held = (self._publisher, PoseWriter(link), [float(value) for value in quaternion])
        self._thread = threading.Thread(target=self._run, args=held, name=self.topic, daemon=True)
        self._thread.start()

    def release(self) -> None:
        """Publish no further pose: the node lets the force fade."""
        if self._thread is None or self._publisher is None:
            return
        self._released.set()
        self._thread.join()
        self._node.destroy_publisher(self._publisher)
        self._thread = self._publisher = None

    def _run(self, publisher: Publisher, writer: PoseWriter, turn: list[float]) -> None:
        position, velocity = self.goal, np.zeros(3)
        clock = self._node.get_clock()
        before = time.monotonic()
        while not self._released.wait(1.0 / RATE):
            now = time.monotonic()
            position, velocity = follow(position, velocity, self.goal, min(now - before, LONGEST_STEP))
            before = now
            publisher.publish(writer.message(clock.now().nanoseconds, (*position.tolist(), *turn)))
