"""`python -m tissue_sim.ros.echo`: a node that sends poses back as they came, or one that only listens to markers.

What a round trip over this middleware and executor takes at least, to hold the node's against.
"""

from __future__ import annotations

import sys

import rclpy
from geometry_msgs.msg import PoseStamped
from rclpy.experimental import EventsExecutor
from rclpy.qos import QoSProfile, ReliabilityPolicy
from visualization_msgs.msg import MarkerArray

from tissue_sim.ros.client import Stop
from tissue_sim.ros.dds import use_shipped_profile

IN, OUT = "echo/measured_cp", "echo/servo_cf"
READY = "ready"
NEWEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)


def main(markers: str = "") -> None:
    """Run until SIGINT or SIGTERM; markers: the topic to listen to instead of echoing."""
    sys.setswitchinterval(0.0005)  # as in the node
    use_shipped_profile()
    with Stop() as stop:
        rclpy.init(args=[])
        node = rclpy.create_node("listener" if markers else "echo", start_parameter_services=False)
        if markers:
            node.create_subscription(MarkerArray, markers, lambda _: None, 1, raw=True)
        else:
            publisher = node.create_publisher(PoseStamped, OUT, NEWEST)
            node.create_subscription(PoseStamped, IN, publisher.publish, NEWEST, raw=True)
        executor = EventsExecutor()
        executor.add_node(node)
        print(READY, flush=True)
        while not stop:
            executor.spin_once(timeout_sec=0.1)
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    main(*sys.argv[1:2])
