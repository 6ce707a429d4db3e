"""What the node tells about itself once a second."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node

from tissue_sim.model import state as st
from tissue_sim.ros.timing import MOST_BEHIND, Timing

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

    def publish(
        self, values: Mapping[str, Any], problems: Mapping[str, int], warnings: Sequence[str] = (), failure: str = ""
    ) -> None:
        """Publish values; problems are counters that make the level WARN when they have grown.

        So do warnings, lines about what is wrong now; failure makes it ERROR.
        """
        status = DiagnosticStatus(name=self._name, hardware_id=self._hardware_id)
        grown = [name for name, count in problems.items() if count > self._last_problems.get(name, 0)]
        self._last_problems = dict(problems)
        status.level = DiagnosticStatus.OK
        status.message = "running"
        lines = [*warnings, *(["new since last second: " + ", ".join(grown)] if grown else [])]
        if lines:
            status.level, status.message = DiagnosticStatus.WARN, "; ".join(lines)
        if failure:
            status.level, status.message = DiagnosticStatus.ERROR, failure
        status.values = [KeyValue(key=key, value=_text(value)) for key, value in {**values, **problems}.items()]
        message = DiagnosticArray(status=[status])
        message.header.stamp = self._clock.now().to_msg()
        self._publisher.publish(message)


def physics_values(timing: Timing, count: st.Longs) -> dict[str, Any]:
    """Values of the loop and its counters."""
    busy = np.percentile(timing.busy, [50.0, 99.0]) if timing.ticks else np.zeros(2)
    region = "asleep" if count[st.ASLEEP] else ("whole", "frozen", "modal")[count[st.REGION]]
    return {
        "tick": int(count[st.TICK]),
        "tick_rate_hz": timing.rate,
        "tick_p50_us": 1e6 * float(busy[0]),
        "tick_p99_us": 1e6 * float(busy[1]),
        "late_p99_us": 1e6 * float(np.percentile(timing.late, 99.0)) if timing.ticks else 0.0,
        "overruns": timing.overruns,
        "real_time_factor": timing.real_time_factor,
        "behind_ms": 1e3 * timing.behind,
        "load": timing.load,
        "region": region,
        "active_nodes": int(count[st.ACTIVE]),
        "contact_count": int(count[st.TOUCHING]),
        "substeps": int(count[st.SUBSTEPS]),
        "frozen_ticks": int(count[st.FROZEN_TICKS]),
        "modal_ticks": int(count[st.MODAL_TICKS]),
        "skipped.asleep": int(count[st.ASLEEP_TICKS]),
        "skipped.small_load": int(count[st.FROZEN_TICKS] + count[st.MODAL_TICKS]),
    }


def timing_warnings(timing: Timing) -> list[str]:
    """What is wrong with the loop's time, in lines."""
    lines = []
    if timing.behind > MOST_BEHIND or abs(timing.real_time_factor - 1.0) > DRIFT:
        lines.append(
            f"simulated time was {1e3 * timing.behind:.1f} ms behind, real-time factor {timing.real_time_factor:.3f}"
        )
    if timing.late_share > MOST_LATE:
        lines.append(f"{timing.late_ticks} ticks were late by more than a period")
    return lines


def _text(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.4f}" if abs(value) < 10.0 else f"{value:.1f}"
    return str(value)
