"""Diagnostics of the node, once a second."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node

from tissue_sim.model.data.state import FAULT_NAMES, Results
from tissue_sim.ros.node.output.loop_timing import MOST_BEHIND, TimingReader
from tissue_sim.ros.shared.organs import Organs
from tissue_sim.ros.shared.report import STARVED, Report

MOST_LATE = 0.01  # fraction of late ticks; single ones occur on every kernel without real-time scheduling
DRIFT = 0.01  # of the real-time factor from 1


class Diagnostics:
    """Publisher of the node's state on /diagnostics."""

    def __init__(self, node: Node, hardware_id: str) -> None:
        self._publisher = node.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self._clock = node.get_clock()
        # With the namespace, if there is one: several nodes share the topic.
        self._node = node.get_fully_qualified_name().strip("/")
        self._hardware_id = hardware_id
        self._last_problems: dict[str, dict[str, int]] = {}  # by the name of the status

    def publish(self, report: Report) -> None:
        """Publish a report as the status "physics", and its parts as one each."""
        statuses = [self._status("physics", report.whole())]
        statuses += [self._status(called, part) for called, part in report.parts.items()]
        message = DiagnosticArray(status=statuses)
        message.header.stamp = self._clock.now().to_msg()
        self._publisher.publish(message)

    def _status(self, called: str, report: Report) -> DiagnosticStatus:
        """Return WARN with a warning or a problem that has grown since the last report, ERROR with a failure."""
        last, self._last_problems[called] = self._last_problems.get(called, {}), dict(report.problems)
        grown = [name for name, count in report.problems.items() if count > last.get(name, 0)]
        status = DiagnosticStatus(name=f"{self._node}: {called}", hardware_id=self._hardware_id)
        status.level, status.message = DiagnosticStatus.OK, report.state
        lines = [*report.warnings, *(["new in the last second: " + ", ".join(grown)] if grown else [])]
        if lines:
            status.level, status.message = DiagnosticStatus.WARN, "; ".join(lines)
        if report.failures:
            status.level, status.message = DiagnosticStatus.ERROR, report.failures[0]
        values = {**report.values, **report.problems}
        status.values = [KeyValue(key=key, value=_text(value)) for key, value in values.items()]
        return status


class LoopReport:
    """Report of how the physics loop keeps time, and what it did.

    names: names of the organs, or a single empty one; titles: titles of the organs.
    """

    def __init__(self, organs: Organs, names: Sequence[str], titles: Sequence[str]) -> None:
        self._organs, self._names, self._titles = organs, names, titles
        self._timing = TimingReader(organs)

    def report(self, report: Report) -> None:
        """Add the loop's times and counters since the last report."""
        timing, results = self._timing.read(), [one.results() for one in self._organs.each]
        busy, late = (
            1e6 * np.percentile(times, [50.0, 99.0, 100.0]) if timing.ticks else np.zeros(3)
            for times in (timing.busy, timing.late)
        )
        report.values |= {
            "tick": results[0].status.tick,
            "tick_rate_hz": timing.rate,
            "realtime_priority": self._organs.loop.priority,
            "tick_p50_us": float(busy[0]),
            "tick_p99_us": float(busy[1]),
            "tick_max_us": float(busy[2]),
            "late_p99_us": float(late[1]),
            "late_max_us": float(late[2]),
            "overruns": timing.overruns,
            "real_time_factor": timing.real_time_factor,
            "behind_ms": 1e3 * timing.behind,
            "load": timing.load,
        }
        joined = self._organs.loop.joined
        for number, (name, title, one) in enumerate(zip(self._names, self._titles, results, strict=True)):
            part = report.part(f"organ {title}", f"{name}." if name else "")
            _add_organ(part, one)
            if not joined.alone:
                part.values["skipped.unfelt"] = int(joined.threshold.ticks[number])
        if len(results) > 1:
            _add_all(report, results)
        report.problems["dropped_ticks"] = timing.dropped
        if timing.behind > MOST_BEHIND or abs(timing.real_time_factor - 1.0) > DRIFT:
            report.warnings.append(
                f"simulated time was {1e3 * timing.behind:.1f} ms behind,"
                f" real-time factor {timing.real_time_factor:.3f}"
            )
        if timing.late_fraction > MOST_LATE:
            report.warnings.append(f"{timing.late_ticks} ticks were late by more than a period")
        if not self._organs.loop.alive:
            report.failures.append("the physics loop has ended")
        elif not self._organs.answers:
            report.failures.append(STARVED)


def _add_organ(report: Report, results: Results) -> None:
    """Add what an organ did."""
    status, count = results.status, results.count
    report.values |= {
        "region": "asleep" if status.asleep else ("whole", "frozen", "modal")[status.region],
        "active_nodes": status.active,
        "contact_count": status.touching,
        "substeps": status.substeps,
        "frozen_ticks": count.frozen_ticks,
        "modal_ticks": count.modal_ticks,
        "slewed_ticks": count.slewed_ticks,
        "steps_found_too_long": count.oscillations,  # no problem: each was halved in time
        "last_fault": FAULT_NAMES[status.fault_kind],
        "turned_cells": status.turned,
        "skipped.asleep": count.asleep_ticks,
        "skipped.small_load": count.frozen_ticks + count.modal_ticks,
    }
    report.problems |= {
        "faults": count.faults,
        "slipped_tools": count.slips,
        "false_rest_shapes": count.snaps,
        "clamped_ticks": count.clamped_ticks,
    }
    report.state = report.values["region"]


def _add_all(report: Report, results: Sequence[Results]) -> None:
    """Add what the organs of a scene did together."""
    awake = sum(not one.status.asleep for one in results)
    report.values |= {
        "region": f"{awake} of {len(results)} organs awake" if awake else "asleep",
        "active_nodes": sum(one.status.active for one in results),
        "contact_count": sum(one.status.touching for one in results),
    }


def _text(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.4f}" if abs(value) < 10.0 else f"{value:.1f}"
    return str(value)
