"""Sends poses to a node or an echo, and takes the time until each is answered."""

from __future__ import annotations

import time
from typing import Any, NamedTuple

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, WrenchStamped
from rclpy.experimental import EventsExecutor
from rclpy.node import Node

from tissue_sim.array_types import Floats
from tissue_sim.errors import UserError
from tissue_sim.organ.organ import Organ
from tissue_sim.ros.latency.echo import IN, OUT
from tissue_sim.ros.shared import client

PATIENCE = 0.05  # s for an answer, after which it counts as lost
RADIUS, DEPTH, SWING = 0.005, 0.003, 2e-4  # m: the tool, how deep it is, by how much it moves


class Trip(NamedTuple):
    """Round trips: their times in s, and how many were not answered."""

    seconds: Floats
    lost: int

    def as_json(self) -> dict[str, float]:
        """Percentiles in us."""
        p50, p99, p999 = 1e6 * np.percentile(self.seconds, [50.0, 99.0, 99.9])
        return {"p50_us": p50, "p99_us": p99, "p99_9_us": p999, "trips": len(self.seconds), "lost": self.lost}


def together(trips: list[Trip]) -> Trip:
    """Trips of all turns as one."""
    return Trip(np.concatenate([trip.seconds for trip in trips]), sum(trip.lost for trip in trips))


class Probe:
    """Sends poses at a rate in Hz from a node of its own, each when the last was answered, and takes the times.

    target: the node that is measured, whose tool `left` meets the organ.
    """

    def __init__(self, node: Node, target: str, organ: Organ, rate: float) -> None:
        self._node, self._target, self._period = node, target, 1.0 / rate
        self._answered, self._answer_clock = 0, 0.0
        self._report: dict[str, str] = {}
        newest = client.stream_qos()
        self._to_node = node.create_publisher(PoseStamped, "left/measured_cp", newest)
        self._to_echo = node.create_publisher(PoseStamped, IN, newest)
        node.create_subscription(WrenchStamped, "left/servo_cf", self._on_answer, newest, raw=True)
        node.create_subscription(PoseStamped, OUT, self._on_answer, newest, raw=True)
        node.create_subscription(DiagnosticArray, "/diagnostics", self._on_report, 10)
        self._executor = EventsExecutor()
        self._executor.add_node(node)
        self._message = PoseStamped()
        self._message.header.frame_id = "organ"
        points = organ.surface_positions
        self._way = np.array([-1.0, 0.0, 0.0])
        self._touch = points[np.argmax(points[:, 0])] - RADIUS * self._way

    def meet(self) -> None:
        """Wait until everybody hears everybody."""
        end = time.monotonic() + 20.0
        while not (self._to_node.get_subscription_count() and self._to_echo.get_subscription_count()):
            if time.monotonic() > end:
                raise UserError("the node or the echo was not found over DDS within 20 s")
            self._executor.spin_once(timeout_sec=0.1)

    def approach(self) -> None:
        """Lead the tool from outside into contact: one that appears inside would be held off."""
        for depth in np.linspace(-0.02, DEPTH, 400):
            self._send(self._to_node, depth)
            self._spin(self._period)

    def trips(self, seconds: float) -> Trip:
        """Pose to wrench, with the tool in contact."""
        return self._exchange(self._to_node, seconds)

    def echoes(self, seconds: float) -> Trip:
        """Pose to the same bytes from the echo; the node gets no poses, and lets its force fade."""
        return self._exchange(self._to_echo, seconds)

    def report(self) -> dict[str, float]:
        """The node's newest figures: ticks, late ones, and the median time of a tick, us; poses go on meanwhile."""
        self._report = {}
        end = time.monotonic() + 5.0
        while not self._report:
            if time.monotonic() > end:
                raise UserError("the node sent no diagnostics for 5 s")
            self._send(self._to_node, DEPTH)
            self._spin(self._period)
        return {name: float(self._report[name]) for name in ("tick", "overruns", "tick_p50_us")}

    def _exchange(self, publisher: Any, seconds: float) -> Trip:
        took, lost = [], 0
        start = deadline = time.monotonic()
        while deadline - start < seconds:
            deadline += self._period
            self._spin(deadline - time.monotonic())
            self._answered = 0
            sent = time.monotonic()
            self._send(publisher, DEPTH + SWING * np.sin(2.0 * np.pi * 5.0 * (sent - start)))
            while not self._answered and time.monotonic() - sent < PATIENCE:
                self._executor.spin_once(timeout_sec=PATIENCE)
            if self._answered:
                took.append(self._answer_clock - sent)
            else:
                lost += 1
            deadline = max(deadline, time.monotonic() - self._period)
        return Trip(np.array(took if took else [PATIENCE]), lost)

    def _spin(self, seconds: float) -> None:
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0.0:
            self._executor.spin_once(timeout_sec=left)

    def _send(self, publisher: Any, depth: float) -> None:
        message = self._message
        position = message.pose.position
        position.x, position.y, position.z = map(float, self._touch + depth * self._way)
        message.header.stamp = self._node.get_clock().now().to_msg()
        publisher.publish(message)

    def _on_answer(self, _: bytes) -> None:
        self._answer_clock = time.monotonic()
        self._answered += 1

    def _on_report(self, message: Any) -> None:
        self._report = client.physics_status([message], self._target) or self._report
