"""Probe `python -m tissue_sim.ros.probes.marker_subscriber NODE`: a subscriber of a node's markers."""

from __future__ import annotations

import sys

from visualization_msgs.msg import MarkerArray

from tissue_sim.ros.shared.client import Stop, client_node
from tissue_sim.ros.shared.executors import make_executor
from tissue_sim.unexpected_errors import catch_all


def main(target: str) -> None:
    """Run until SIGINT or SIGTERM."""
    with Stop() as stop, client_node("listener", "") as node:
        node.create_subscription(MarkerArray, f"/{target}/markers", lambda _: None, 1, raw=True)
        executor = make_executor()
        executor.add_node(node)
        while not stop:
            executor.spin_once(timeout_sec=0.1)


if __name__ == "__main__":
    catch_all("listener")
    main(sys.argv[1])
