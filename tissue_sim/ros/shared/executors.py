"""The executor of node and probes."""

from __future__ import annotations

from rclpy.executors import Executor, SingleThreadedExecutor

try:
    from rclpy.experimental import EventsExecutor
except ImportError:  # rclpy before 7.1.4, an apt installation that was not upgraded since
    EventsExecutor = None  # type: ignore[assignment]

OLD_RCLPY = (
    "rclpy is older than 7.1.4 and has no EventsExecutor, so answering a pose takes longer; upgrade ros-jazzy-rclpy"
)


def make_executor() -> Executor:
    """Return the one that costs least for a pose, or in an old rclpy the usual one."""
    return SingleThreadedExecutor() if EventsExecutor is None else EventsExecutor()
