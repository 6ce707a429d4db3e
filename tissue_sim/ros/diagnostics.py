"""What the node tells about itself once a second."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node

from tissue_sim.model import state as st
from tissue_sim.ros.physics import Timing


class Diagnostics:
    """Publishes the node's state on /diagnostics."""

    def __init__(self, node: Node, hardware_id: str) -> None:
        self._publisher = node.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self._clock = node.get_clock()
        self._name = f"{node.get_name()}: physics"
        self._hardware_id = hardware_id
        self._last_problems: dict[str, int] = {}

    def publish(self, values: Mapping[str, Any], problems: Mapping[str, int], failure: str = "") -> None:
        """Publish values; problems are counters that make the level WARN when they have grown, failure ERROR."""
        status = DiagnosticStatus(name=self._name, hardware_id=self._hardware_id)
        grown = [name for name, count in problems.items() if count > self._last_problems.get(name, 0)]
        self._last_problems = dict(problems)
        status.level = DiagnosticStatus.OK
        status.message = "running"
        if grown:
            status.level, status.message = DiagnosticStatus.WARN, "new since last second: " + ", ".join(grown)
        if failure:
            status.level, status.message = DiagnosticStatus.ERROR, failure
        status.values = [KeyValue(key=key, value=_text(value)) for key, value in {**values, **problems}.items()]
        message = DiagnosticArray(status=[status])
        message.header.stamp = self._clock.now().to_msg()
        self._publisher.publish(message)


def physics_values(timing: Timing, count: st.Longs) -> dict[str, Any]:
    """Values of the loop and its counters."""
    region = "asleep" if count[st.ASLEEP] else ("whole", "frozen", "modal")[count[st.REGION]]
    return {
        "tick": int(count[st.TICK]),
        "tick_rate_hz": timing.rate,
        "tick_p50_us": 1e6 * timing.p50,
        "tick_p99_us": 1e6 * timing.p99,
        "late_p99_us": 1e6 * timing.late_p99,
        "overruns": timing.overruns,
        "dropped_ticks": timing.dropped,
        "real_time_factor": timing.real_time_factor,
        "region": region,
        "active_nodes": int(count[st.ACTIVE]),
        "contact_count": int(count[st.TOUCHING]),
        "substeps": int(count[st.SUBSTEPS]),
        "asleep_ticks": int(count[st.ASLEEP_TICKS]),
        "frozen_ticks": int(count[st.FROZEN_TICKS]),
        "modal_ticks": int(count[st.MODAL_TICKS]),
    }


def _text(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.4f}" if abs(value) < 10.0 else f"{value:.1f}"
    return str(value)
