"""A hand that pokes an organ once a second by the clock, and records the forces that it feels."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import WrenchStamped
from rclpy.node import Node

from tissue_sim.array_types import Floats
from tissue_sim.errors import UserError
from tissue_sim.organ.organ import Organ
from tissue_sim.ros.probes.tool_driver import DEPTH, Hand
from tissue_sim.ros.shared import client
from tissue_sim.ros.shared.priority import with_priority

POKES = 1.0  # Hz
SHORTEST = 3.0  # s of poking in which the node has reported twice


class NodeReport(NamedTuple):
    """One report of the node."""

    seconds: float  # s, its stamp
    tick: int  # so far
    late: int  # ticks late by more than a period, so far
    dropped: int  # ticks dropped, so far
    pace: float  # simulated time over that of the clock, since the previous report
    busy: float  # s, median time of a tick
    degraded: str  # what is given up
    busy_p99: float = 0.0  # s, 99th percentile of the time of a tick, and
    late_p99: float = 0.0  # s, of its lateness
    longest: float = 0.0  # s, of a tick since the previous report
    latest: float = 0.0  # s, by which a tick was late since then, at most
    substeps: int = 0  # of the newest tick


class PokeFigures(NamedTuple):
    """Forces and reports during pokes."""

    peaks: Floats  # N, the highest force of each whole poke
    gap: float  # s, the longest between two poses: delay of the hand itself
    reports: list[NodeReport]


def depth_after(seconds: float) -> float:
    """Return how deep the tool is, m, after so many s: it goes as far out as in, and begins outside."""
    return -DEPTH * float(np.cos(2.0 * np.pi * POKES * seconds))


class PokeProbe(Hand):
    """A hand that pokes; like a haptic bridge it sends the present pose, and none for a moment that it missed.

    rate: poses per second, Hz; priority: real-time priority of the hand.
    """

    def __init__(self, node: Node, target: str, organ: Organ, *, rate: float = 1000.0, priority: int = 0) -> None:
        super().__init__(node, organ, rate)
        self._target, self._priority = target, priority
        self._wrenches = client.NewestMessage(node, WrenchStamped, "left/servo_cf", client.stream_qos())
        self._reports = client.NewestMessage(node, DiagnosticArray, "/diagnostics", 10)  # type: ignore[arg-type]

    def poke(self, seconds: float, watch: Callable[[], object] = lambda: None) -> PokeFigures:
        """Poke for some time, SHORTEST at least.

        watch: called after each poke. Raises UserError when the node sends no report meanwhile.
        """
        self._wrenches.take()
        self._reports.take_all()
        found = with_priority(lambda: self._poke(int(seconds * POKES), watch), self._priority)
        if len(found.reports) < 2:
            raise UserError(f"the node sent no diagnostics for {seconds:g} s")
        return found

    def poke_until_whole(self, seconds: float, watch: Callable[[], object] = lambda: None) -> float:
        """Poke until the node gives nothing up, but not much longer than a limit.

        seconds: the limit, s; watch: called after each poke. Returns how long that took, s.
        """
        began = time.monotonic()
        while (took := time.monotonic() - began) < seconds:
            if self.poke(SHORTEST, watch).reports[-1].degraded == "none":
                break
        return took

    def _poke(self, pokes: int, watch: Callable[[], object]) -> PokeFigures:
        peaks, reports, gap, seen = np.zeros(pokes + 1), [], 0.0, 0
        began = sent = time.monotonic()
        while (elapsed := time.monotonic() - began) < pokes / POKES:
            gap = max(gap, began + elapsed - sent)
            sent = began + elapsed
            self.send(depth_after(elapsed))
            wrench = self._wrenches.take()
            if wrench is not None:
                force = wrench.wrench.force
                poke = int(elapsed * POKES)
                peaks[poke] = max(peaks[poke], float(np.hypot(np.hypot(force.x, force.y), force.z)))
            reports += self._take_reports()
            if int(elapsed * POKES) > seen:
                seen = int(elapsed * POKES)
                watch()
            time.sleep(self._period * (1.0 - (time.monotonic() - began) / self._period % 1.0))
        return PokeFigures(peaks[:pokes], gap, reports)

    def _take_reports(self) -> list[NodeReport]:
        found = []
        for report in self._reports.take_all():
            values = client.physics_status([report], self._target)
            if values is not None:
                found.append(node_report_of(report.header.stamp, values))
        return found


def node_report_of(stamp: Time, values: Mapping[str, str]) -> NodeReport:
    """Return a report of the node's physics."""
    return NodeReport(
        stamp.sec + 1e-9 * stamp.nanosec,
        int(values["tick"]),
        int(values["overruns"]),
        int(values["dropped_ticks"]),
        float(values["real_time_factor"]),
        1e-6 * float(values["tick_p50_us"]),
        values["degraded"],
        1e-6 * float(values["tick_p99_us"]),
        1e-6 * float(values["late_p99_us"]),
        1e-6 * float(values["tick_max_us"]),
        1e-6 * float(values["late_max_us"]),
        int(values["substeps"]),
    )
