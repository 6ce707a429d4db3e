"""A tool held without a haptic device: its pose follows a goal, and is published while it is held."""

from __future__ import annotations

import threading
import time

import numpy as np
from rclpy.node import Node
from rclpy.publisher import Publisher

from tissue_sim.array_types import Floats
from tissue_sim.ros.shared.tool_link import PoseWriter, ToolLink

RATE = 250.0  # Hz, of the poses
TOP_SPEED = 0.2  # m/s; a sudden motion of the mouse must not hit the tissue
RISE_TIME = 0.05  # s in which the tool covers most of a short distance
ACCELERATION = TOP_SPEED / RISE_TIME  # m/s^2
LONGEST_STEP = 0.02  # s; a delayed thread continues from its position without a leap


def follow(position: Floats, velocity: Floats, goal: Floats, step: float) -> tuple[Floats, Floats]:
    """Return the new position, m, and velocity, m/s, after one step towards a goal.

    No faster than TOP_SPEED, without a jump in speed, and without overshooting a goal that stands still.

    position (3,) m; velocity (3,) m/s; goal (3,) m; step: duration of the step, s.
    """
    wanted = (goal - position) / max(RISE_TIME, 2.0 * step)
    velocity = velocity + limited(limited(wanted, TOP_SPEED) - velocity, ACCELERATION * step)
    return position + step * velocity, velocity


def limited(vector: Floats, length: float) -> Floats:
    """Return the vector, cut to a length."""
    size = float(np.linalg.norm(vector))
    return vector if size <= length else vector * (length / size)


class PokedTool:
    """Publisher of a tool's poses in a separate thread, between `take` and `release`.

    The thread keeps publishing while the viewer is busy with a picture, so that no pose gets stale.
    """

    def __init__(self, node: Node, name: str) -> None:
        self._node, self._name = node, name
        self._link: ToolLink | None = None
        self._publisher: Publisher | None = None
        self._thread: threading.Thread | None = None
        self._released = threading.Event()
        self.goal: Floats = np.zeros(3)  # m in the organ's frame; replaced as a whole, from any thread

    def use(self, link: ToolLink) -> None:
        """Use a link to the tool from now on; a tool that is held by another one is released."""
        if link != self._link:
            self.release()
            self._link = link

    @property
    def topic(self) -> str:
        """Topic of the poses."""
        return (self._link or ToolLink.by_default(self._name, "")).topics.names["measured_cp"]

    @property
    def held(self) -> bool:
        """Whether it is between `take` and `release`."""
        return self._thread is not None

    def other_publishers(self) -> int:
        """Return how many others publish the tool's poses."""
        return int(self._node.count_publishers(self.topic)) - (1 if self.held else 0)

    def take(self, position: Floats, quaternion: Floats, frame_id: str) -> None:
        """Hold the tool at a pose until `release`.

        position (3,) m: its position in the organ's frame; quaternion (4,): its rotation xyzw; frame_id: frame of the
        organ.
        """
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
