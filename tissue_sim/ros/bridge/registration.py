"""Where a running node's organ is, which may change while a bridge plays."""

from __future__ import annotations

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from rclpy.qos import QoSProfile

from tissue_sim.json_types import JsonObject
from tissue_sim.ros.shared import client
from tissue_sim.ros.shared.node_parameters import NodeParameters


class Registration:
    """Reads the parameters of the node `target` again after its diagnostics report that `organ_pose` has changed."""

    def __init__(self, node: Node, target: str, parameters: NodeParameters) -> None:
        self._target, self._parameters = target, parameters
        self._reports = client.NewestMessage(node, DiagnosticArray, "/diagnostics", QoSProfile(depth=10))
        self._count: str | None = None  # of the newest report, how often the organ was registered

    def poll(self) -> JsonObject | None:
        """Return the node's parameters once they have been read again, else None. Doesn't wait."""
        status = client.physics_status(self._reports.take_all(), self._target)
        if status is not None and status.get("registrations") != self._count:
            self._count = status.get("registrations")
            self._parameters.ask()
        return self._parameters.poll()
