"""A probe of latency: sends poses to a node or an echo, and measures the time until the answer."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, WrenchStamped
from rclpy.node import Node
from rclpy.publisher import Publisher

from tissue_sim.array_types import Floats
from tissue_sim.errors import UserError
from tissue_sim.organ.organ import Organ
from tissue_sim.ros.probes.echo import IN, OUT
from tissue_sim.ros.probes.graph import first_within
from tissue_sim.ros.probes.tool_driver import DEPTH, FAR, SWING, Hand
from tissue_sim.ros.shared import client
from tissue_sim.ros.shared.cdr import parse_stamped
from tissue_sim.ros.shared.executors import make_executor
from tissue_sim.ros.shared.tool_messages import N_WRENCH

PATIENCE = 0.05  # s for an answer, after which it counts as lost
STEP = 3e-4  # m by which a pose goes deeper, or comes back
AT_REST, AFTER = 0.12, 0.1  # s of poses at one place before it, and after it
CHANGED = 0.02  # fraction of the whole change of the force, and
RESTLESS = 3.0  # times its variation at rest: the first change exceeds both
SETTLING, PAUSE = 2.0, 0.25  # s until the organ rests, and between poses that are to find the node napping


class Trip(NamedTuple):
    """Round trips: their times in s, and how many were not answered, which count as PATIENCE."""

    seconds: Floats
    lost: int

    def as_json(self) -> dict[str, float]:
        """Return percentiles in us."""
        p50, p99, p999 = 1e6 * np.percentile(self.seconds, [50.0, 99.0, 99.9])
        return {"p50_us": p50, "p99_us": p99, "p99_9_us": p999, "trips": len(self.seconds), "lost": self.lost}


def together(trips: list[Trip]) -> Trip:
    """Return the trips of all turns as one."""
    return Trip(np.concatenate([trip.seconds for trip in trips]), sum(trip.lost for trip in trips))


def first_change(sent: float, answers: Sequence[tuple[float, Floats]]) -> float | None:
    """Return the time, s, from a pose to the first wrench that was computed with it; None where there is none.

    answers: when wrenches came, s, and their forces (3,) N, from a while at rest before the pose until the force has
    changed because of it.
    """
    before = np.array([force for at, force in answers if at < sent])
    after = [(at, force) for at, force in answers if at >= sent]
    if len(before) < 2 or not after:
        return None
    rest = before[-20:]
    middle = rest.mean(axis=0)
    restless = float(np.linalg.norm(rest - middle, axis=1).max())
    least = max(CHANGED * float(np.linalg.norm(after[-1][1] - middle)), RESTLESS * restless)
    return next((at - sent for at, force in after if np.linalg.norm(force - middle) > least), None)


def swinging(seconds: float) -> float:
    """Return how deep the tool is, m, after so many s."""
    return DEPTH + SWING * float(np.sin(2.0 * np.pi * 5.0 * seconds))


class Probe(Hand):
    """A hand that sends each pose when the last was answered, and measures the times; to the node or to the echo.

    rate: poses per second, Hz.
    """

    def __init__(self, node: Node, target: str, organ: Organ, rate: float) -> None:
        super().__init__(node, organ, rate)
        self._target = target
        self._answered, self._answer_clock = 0, 0.0
        self._answers: list[tuple[float, bytes]] = []  # since the last step
        self._rng = np.random.default_rng(1)
        self._report: dict[str, str] = {}
        newest = client.stream_qos()
        self._to_echo = node.create_publisher(PoseStamped, IN, newest)
        node.create_subscription(WrenchStamped, "left/servo_cf", self._on_wrench, newest, raw=True)
        node.create_subscription(PoseStamped, OUT, self._on_answer, newest, raw=True)
        node.create_subscription(DiagnosticArray, "/diagnostics", self._on_report, 10)
        self._executor = make_executor()
        self._executor.add_node(node)

    def meet(self) -> None:
        """Wait until everybody hears everybody. Raises UserError when they don't."""
        super().meet()
        first_within(self._to_echo.get_subscription_count, 20.0, "the echo was not found over DDS")

    def changes(self, seconds: float, rate: float) -> Trip:
        """Measure from a pose to the first wrench that was computed with it, by steps in contact.

        rate: poses per second, Hz.
        """
        took, lost, before, after = [], 0, DEPTH, DEPTH + STEP
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            change = self._step(before, after, 1.0 / rate)
            took.append(PATIENCE if change is None else change)
            lost += change is None
            before, after = after, before
        return Trip(np.array(took), lost)

    def _step(self, before: float, after: float, period: float) -> float | None:
        """Send poses at one depth and then at another; return the time, s, until the force answers."""
        self._answers.clear()
        # Poses must not always come at the same moment of a tick.
        deadline, sent = time.monotonic() + period * self._rng.random(), 0.0
        counts = max(3, round(AT_REST / period)), max(2, round(AFTER / period))
        for depth, count in zip((before, after), counts, strict=True):
            for index in range(count):
                self._spin(deadline - time.monotonic())
                if depth == after and index == 0:
                    sent = time.monotonic()
                self.send(depth)
                deadline += period
        self._spin(deadline - time.monotonic())
        answers = [(at, np.array(parse_stamped(raw, N_WRENCH).values[:3])) for at, raw in self._answers]
        return first_change(sent, answers)

    def echoes(self, seconds: float, rate: float) -> Trip:
        """Measure from a pose to the same bytes from the echo; the node gets no poses, and its force fades.

        rate: poses per second, Hz.
        """
        return self._exchange(self._to_echo, seconds, 1.0 / rate, swinging)

    def wakes(self, seconds: float) -> tuple[Trip, Trip]:
        """Measure from pose to wrench and from pose to echo after a pause in which the node, at rest, has begun to nap.

        seconds: duration of each, s.
        """
        self.send(FAR)
        self._spin(SETTLING)
        return (
            self._exchange(self._to_node, seconds, PAUSE, lambda _: FAR),
            self._exchange(self._to_echo, seconds, PAUSE, lambda _: FAR),
        )

    def report(self) -> dict[str, float]:
        """Return the node's newest ticks, late ticks and median time of a tick, us; poses go on meanwhile."""
        self._report = {}
        end = time.monotonic() + 5.0
        while not self._report:
            if time.monotonic() > end:
                raise UserError("the node sent no diagnostics for 5 s")
            self.send(DEPTH)
            self._spin(self._period)
        return {name: float(self._report[name]) for name in ("tick", "overruns", "tick_p50_us")}

    def _exchange(self, publisher: Publisher, seconds: float, period: float, depth: Callable[[float], float]) -> Trip:
        took, lost = [], 0
        start = deadline = time.monotonic()
        while deadline - start < seconds:
            deadline += period
            self._spin(deadline - time.monotonic())
            self._answered = 0
            sent = time.monotonic()
            self.send(depth(sent - start), publisher)
            while not self._answered and time.monotonic() - sent < PATIENCE:
                self._executor.spin_once(timeout_sec=PATIENCE)
            if self._answered:
                took.append(self._answer_clock - sent)
            else:
                took.append(PATIENCE)
                lost += 1
            deadline = max(deadline, time.monotonic() - period)
        return Trip(np.array(took), lost)

    def _spin(self, seconds: float) -> None:
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0.0:
            self._executor.spin_once(timeout_sec=left)

    def _on_wrench(self, raw: bytes) -> None:
        self._on_answer(raw)
        self._answers.append((self._answer_clock, raw))

    def _on_answer(self, _: bytes) -> None:
        self._answer_clock = time.monotonic()
        self._answered += 1

    def _on_report(self, message: DiagnosticArray) -> None:
        self._report = client.physics_status([message], self._target) or self._report
