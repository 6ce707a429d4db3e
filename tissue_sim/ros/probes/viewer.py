"""A subscriber like the viewer: no callback, the newest message on request.

The program `python -m tissue_sim.ros.probes.viewer SECONDS TOPIC ...` prints, as JSON, the rate of each topic, Hz, once
all have come.
"""

from __future__ import annotations

import json
import sys
import time
from types import TracebackType
from typing import Self

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import WrenchStamped
from rclpy.node import Node
from sensor_msgs.msg import CompressedImage, Image, PointCloud2
from shape_msgs.msg import Mesh
from visualization_msgs.msg import MarkerArray

from tissue_sim.ros.probes.graph import first_within
from tissue_sim.ros.shared.client import NewestMessage, client_node, latched_qos, stream_qos
from tissue_sim.unexpected_errors import catch_all

TURN = 0.004  # s between two checks
KINDS = {
    "mesh": (Mesh, latched_qos),
    "markers": (MarkerArray, latched_qos),
    "surface": (PointCloud2, stream_qos),
    "servo_cf": (WrenchStamped, stream_qos),
    "diagnostics": (DiagnosticArray, stream_qos),
    "image_raw": (Image, stream_qos),
    "compressed": (CompressedImage, stream_qos),
}


class Viewer:
    """Context with subscriptions to some topics, whose last word names their type; counts messages, as bytes."""

    def __init__(self, node: Node, *topics: str) -> None:
        self._node, self._topics = node, topics
        self._inboxes: dict[str, NewestMessage] = {}
        self.newest: dict[str, bytes] = {}
        self.count: dict[str, int] = {}

    def __enter__(self) -> Self:
        for topic in self._topics:
            kind, qos = KINDS[topic.rpartition("/")[2]]
            self._inboxes[topic] = NewestMessage(self._node, kind, topic, qos(), raw=True)
        self.newest = {}
        return self

    def __exit__(self, kind: type | None, error: BaseException | None, trace: TracebackType | None) -> None:
        for inbox in self._inboxes.values():
            inbox.close()

    def look(self, seconds: float) -> None:
        """Take messages for some time, s, counted from zero."""
        self.count = dict.fromkeys(self._inboxes, 0)
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self._take()
            time.sleep(TURN)

    def wait(self) -> float:
        """Wait until a message of every topic has come.

        Returns how long that took, s. Raises UserError when one doesn't come within 40 s.
        """
        began = time.monotonic()

        def came() -> bool:
            self._take()
            return len(self.newest) == len(self._topics)

        first_within(came, 40.0, f"not all of {', '.join(self._topics)} arrived")
        return time.monotonic() - began

    def _take(self) -> None:
        for topic, inbox in self._inboxes.items():
            if (found := inbox.take()) is not None:
                self.newest[topic] = found
                self.count[topic] = self.count.get(topic, 0) + 1


def main(seconds: str, *topics: str) -> None:
    """Look for so many s."""
    with client_node("watcher", "") as node, Viewer(node, *topics) as viewer:
        viewer.wait()
        viewer.look(float(seconds))
        print(json.dumps({topic: count / float(seconds) for topic, count in viewer.count.items()}))


if __name__ == "__main__":
    catch_all("viewer")
    main(*sys.argv[1:])
