"""What a camera reports of its pictures."""

from __future__ import annotations

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node

from tissue_sim.ros.shared.client import NewestMessage

KEPT = 50  # reports


class PictureTimes:
    """Reports of a camera of that name, since it was made.

    camera: name of the camera.
    """

    def __init__(self, node: Node, camera: str) -> None:
        self._name = f"{camera}: pictures"
        self._reports = NewestMessage(node, DiagnosticArray, "/diagnostics", KEPT)  # type: ignore[arg-type]

    def close(self) -> list[float]:
        """Unsubscribe; return the time of a picture, ms, in each report of a second with pictures."""
        found = [
            float(item.value)
            for report in self._reports.take_all()
            for status in report.status
            for item in status.values
            if status.name == self._name and status.message == "running" and item.key == "picture_ms"
        ]
        self._reports.close()
        return found
