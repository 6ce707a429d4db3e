"""Probe `python -m tissue_sim.ros.probes.sender TOPIC KIND FILE RATE`: publishes a file's bytes at a rate, Hz.

It measures the least processor time for messages of that size over this middleware, with which the node's is compared.
KIND: markers, as the node sends them, or surface.
"""

from __future__ import annotations

import sys
import threading
import time
from pathlib import Path

from sensor_msgs.msg import PointCloud2
from visualization_msgs.msg import MarkerArray

from tissue_sim.ros.shared.client import Stop, client_node, latched_qos, stream_qos
from tissue_sim.unexpected_errors import catch_all

KINDS = {"markers": (MarkerArray, latched_qos), "surface": (PointCloud2, stream_qos)}


def main(topic: str, kind: str, file: str, rate: str) -> None:
    """Run until SIGINT or SIGTERM."""
    message, period = Path(file).read_bytes(), 1.0 / float(rate)
    what, qos = KINDS[kind]
    woken = threading.Event()  # as in the node, whose outlet waits for one
    with Stop() as stop, client_node("sender", "") as node:
        publisher = node.create_publisher(what, topic, qos())
        due = time.monotonic()
        while not stop:
            publisher.publish(message)
            due += period
            woken.wait(max(0.0, due - time.monotonic()))


if __name__ == "__main__":
    catch_all("sender")
    main(*sys.argv[1:5])
