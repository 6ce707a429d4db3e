"""Probe `python -m tissue_sim.ros.probes.echo [PRIORITY]`: sends poses back.

It measures the shortest round trip over this middleware and executor, with which the node's is compared.
"""

from __future__ import annotations

import sys

from geometry_msgs.msg import PoseStamped

from tissue_sim.ros.shared.client import Stop, client_node, stream_qos
from tissue_sim.ros.shared.executors import make_executor
from tissue_sim.ros.shared.priority import prefer
from tissue_sim.unexpected_errors import catch_all

IN, OUT = "echo/measured_cp", "echo/servo_cf"


def main(priority: str = "0") -> None:
    """Run until SIGINT or SIGTERM, with a real-time priority."""
    sys.setswitchinterval(0.0005)  # as in the node
    with Stop() as stop, client_node("echo", "") as node:
        publisher = node.create_publisher(PoseStamped, OUT, stream_qos())
        node.create_subscription(PoseStamped, IN, publisher.publish, stream_qos(), raw=True)
        executor = make_executor()
        executor.add_node(node)
        prefer(int(priority))
        while not stop:
            executor.spin_once(timeout_sec=0.1)


if __name__ == "__main__":
    catch_all("echo")
    main(*sys.argv[1:2])
