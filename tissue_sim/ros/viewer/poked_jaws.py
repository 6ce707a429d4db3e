"""Jaws opened and closed without a haptic device: their angle follows a goal, published meanwhile."""

from __future__ import annotations

import threading
import time

import numpy as np
from rclpy.node import Node
from rclpy.publisher import Publisher
from sensor_msgs.msg import JointState

from tissue_sim.array_types import Floats
from tissue_sim.ros.shared.tool_link import ToolLink
from tissue_sim.ros.viewer.poked_tool import LONGEST_STEP, RATE, follow

STANDS = 0.5  # s at the goal after which no further angle is published: the node keeps the last one
PATIENCE = 3.0  # s, at most, for DDS to connect the topic's ends
SHORTEST = 0.005  # m from hinge to tips, for the speed of the tips


class PokedJaws:
    """Publisher of a tool's measured_js in a separate thread, from a `turn` until the jaws reach the goal.

    Their tips move like a held tool: no faster, and without a jump in speed.
    """

    def __init__(self, node: Node, link: ToolLink) -> None:
        self._node, self.link = node, link
        self.topic = link.topics.names["measured_js"]
        self._lever = 0.5 * max(link.tool.length, SHORTEST)  # m that a tip moves for one rad between the jaws
        self._publisher: Publisher | None = None
        self._thread: threading.Thread | None = None
        self._closed = threading.Event()
        self._lock = threading.Lock()  # for the decision whether the thread goes on
        self._goal = 0.0  # rad; replaced as a whole, from any thread
        self._touched = -np.inf  # monotonic s

    @property
    def moving(self) -> bool:
        """Whether angles are published."""
        return self._thread is not None

    def other_publishers(self) -> int:
        """Return how many others publish the angle."""
        return int(self._node.count_publishers(self.topic)) - (1 if self._publisher is not None else 0)

    def turn(self, goal: float, start: float) -> None:
        """Move the jaws to an angle; from `start`, unless they are being moved already.

        goal: the angle, rad; start: the present angle, rad.
        """
        with self._lock:
            self._goal, self._touched = goal, time.monotonic()
            if self._thread is not None:
                return
            if self._publisher is None:
                self._publisher = self._node.create_publisher(JointState, self.topic, self.link.qos)
            words = (self._publisher, start)
            self._thread = threading.Thread(target=self._run, args=words, name=self.topic, daemon=True)
            self._thread.start()

    def close(self) -> None:
        """Publish no further angle."""
        self._closed.set()
        thread = self._thread
        if thread is not None:
            thread.join()
        if self._publisher is not None:
            self._node.destroy_publisher(self._publisher)
            self._publisher = None

    def _run(self, publisher: Publisher, start: float) -> None:
        message = JointState(name=["jaw"], position=[0.0])
        clock, lever = self._node.get_clock(), self._lever
        place: Floats = np.array([lever * start])
        speed = np.zeros(1)
        end = time.monotonic() + PATIENCE
        while publisher.get_subscription_count() == 0 and time.monotonic() < end and not self._closed.wait(0.02):
            pass
        before = stood = time.monotonic()
        while not self._closed.wait(1.0 / RATE):
            now = time.monotonic()
            goal = np.array([lever * self._goal])
            place, speed = follow(place, speed, goal, min(now - before, LONGEST_STEP))
            before = now
            message.header.stamp = clock.now().to_msg()
            message.position[0] = float(place[0]) / lever
            publisher.publish(message)
            if abs(float(place[0] - goal[0])) > 1e-5:
                stood = now
            with self._lock:
                if now - max(stood, self._touched) > STANDS:
                    self._thread = None
                    return
