"""What the node tells about itself once a second."""

from __future__ import annotations

from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node

from tissue_sim.model.state import FAULT_NAMES
from tissue_sim.ros.node.loop_timing import MOST_BEHIND, TimingReader
from tissue_sim.ros.shared.physics import Physics
from tissue_sim.ros.shared.report import STARVED, Report

MOST_LATE = 0.01  # share of late ticks; single ones come with every kernel that is not a real-time one
DRIFT = 0.01  # of the real-time factor from 1


class Diagnostics:
    """Publishes the node's state on /diagnostics."""

    def __init__(self, node: Node, hardware_id: str) -> None:
        self._publisher = node.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self._clock = node.get_clock()
        # With the namespace, if there is one: several nodes share the topic.
        self._name = f"{node.get_fully_qualified_name().strip('/')}: physics"
        self._hardware_id = hardware_id
        self._last_problems: dict[str, int] = {}

    def publish(self, report: Report) -> None:
        """Publish a report: WARN with a warning or a problem that has grown since the last, ERROR with a failure."""
        problems = report.problems
        status = DiagnosticStatus(name=self._name, hardware_id=self._hardware_id)
        grown = [name for name, count in problems.items() if count > self._last_problems.get(name, 0)]
        self._last_problems = dict(problems)
        status.level = DiagnosticStatus.OK
        status.message = "running"
        lines = [*report.warnings, *(["new since last second: " + ", ".join(grown)] if grown else [])]
        if lines:
            status.level, status.message = DiagnosticStatus.WARN, "; ".join(lines)
        if report.failures:
            status.level, status.message = DiagnosticStatus.ERROR, report.failures[0]
        status.values = [KeyValue(key=key, value=_text(value)) for key, value in {**report.values, **problems}.items()]
        message = DiagnosticArray(status=[status])
        message.header.stamp = self._clock.now().to_msg()
        self._publisher.publish(message)


class LoopReport:
    """Tells how the physics loop keeps time, and what it did."""

    def __init__(self, physics: Physics) -> None:
        self._physics = physics
        self._timing = TimingReader(physics)

    def report(self, report: Report) -> None:
        """Add the loop's times and counters since the last report."""
        timing, (status, count, _, _) = self._timing.read(), self._physics.results()
        busy = np.percentile(timing.busy, [50.0, 99.0]) if timing.ticks else np.zeros(2)
        region = "asleep" if status.asleep else ("whole", "frozen", "modal")[status.region]
        report.values |= {
            "tick": status.tick,
            "tick_rate_hz": timing.rate,
            "realtime_priority": self._physics.loop.priority,
            "tick_p50_us": 1e6 * float(busy[0]),
            "tick_p99_us": 1e6 * float(busy[1]),
            "late_p99_us": 1e6 * float(np.percentile(timing.late, 99.0)) if timing.ticks else 0.0,
            "overruns": timing.overruns,
            "real_time_factor": timing.real_time_factor,
            "behind_ms": 1e3 * timing.behind,
            "load": timing.load,
            "region": region,
            "active_nodes": status.active,
            "contact_count": status.touching,
            "substeps": status.substeps,
            "frozen_ticks": count.frozen_ticks,
            "modal_ticks": count.modal_ticks,
            "slewed_ticks": count.slewed_ticks,
            "steps_found_too_long": count.shivers,  # no problem: each was halved before anything was lost
            "last_fault": FAULT_NAMES[status.fault_kind],
            "turned_cells": status.turned,
            "skipped.asleep": count.asleep_ticks,
            "skipped.small_load": count.frozen_ticks + count.modal_ticks,
        }
        report.problems |= {
            "faults": count.faults,
            "false_rest_shapes": count.snaps,
            "clamped_ticks": count.clamped_ticks,
            "dropped_ticks": timing.dropped,
        }
        if timing.behind > MOST_BEHIND or abs(timing.real_time_factor - 1.0) > DRIFT:
            report.warnings.append(
                f"simulated time was {1e3 * timing.behind:.1f} ms behind,"
                f" real-time factor {timing.real_time_factor:.3f}"
            )
        if timing.late_share > MOST_LATE:
            report.warnings.append(f"{timing.late_ticks} ticks were late by more than a period")
        if not self._physics.loop.alive:
            report.failures.append("the physics loop has ended")
        elif not self._physics.answers:
            report.failures.append(STARVED)


def _text(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.4f}" if abs(value) < 10.0 else f"{value:.1f}"
    return str(value)
