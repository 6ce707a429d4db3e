"""Client of a node's service ~/cut."""

from __future__ import annotations

from collections.abc import Callable

from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Path
from rcl_interfaces.msg import Parameter, ParameterType
from rcl_interfaces.srv import SetParameters
from rclpy.client import Client
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from std_srvs.srv import Trigger

from tissue_sim.array_types import Floats
from tissue_sim.errors import UserError
from tissue_sim.ros.shared import client
from tissue_sim.ros.shared.cut_path import cut_path
from tissue_sim.ros.shared.qos import RELIABLE


class Cutter:
    """What cuts an organ of a running node.

    below: what comes before the topics of the organ; longest: longest wait for each answer, s.
    """

    def __init__(self, node: Node, target: str, below: str, longest: float, stop: client.Stop) -> None:
        self._below, self._longest, self._stop = below, longest, stop
        self._path = node.create_publisher(Path, f"{below}cut_path", RELIABLE)
        self._cuts = client.NewestMessage(node, DiagnosticArray, f"{below}cuts", client.latched_qos())
        own = client.node_beside(node, "cutter")
        self._cut = own.create_client(Trigger, f"{below}cut")
        self._set = own.create_client(SetParameters, f"/{target}/set_parameters")
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(own)

    def cut(self, polyline: Floats, direction: Floats, depth: float, frame_id: str) -> float:
        """Cut; return the depth that the node reports, m.

        polyline (m, 3) m: where the blade begins; direction (3,): unit direction of the blade; depth: how far it is
        moved, m; frame_id: frame of both. Raises UserError where the node doesn't answer, or refuses the cut.
        """
        value = Parameter(name="cut_depth")
        value.value.type, value.value.double_value = ParameterType.PARAMETER_DOUBLE, depth
        request = SetParameters.Request(parameters=[value])
        (result,) = self._call(self._set, request, SetParameters.Response).results
        if not result.successful:
            raise UserError(f"the node refused cut_depth {depth:g}: {result.reason}")
        self._wait(lambda: self._path.get_subscription_count() > 0, "cut_path")
        self._path.publish(cut_path(polyline, direction, frame_id))
        answer = self._call(self._cut, Trigger.Request(), Trigger.Response)
        # A path comes on a topic of its own, and may come after the call.
        if not answer.success and "no path has come" in answer.message:
            answer = self._wait(self._cut_again, "cut")
        if not answer.success:
            raise UserError(f"the node made no cut: {answer.message}")
        return float(self._wait(lambda: self._depth_of(answer.message), "cuts"))

    def _cut_again(self) -> Trigger.Response | None:
        answer = self._call(self._cut, Trigger.Request(), Trigger.Response)
        return None if "no path has come" in answer.message else answer

    def _depth_of(self, text: str) -> float | None:
        """Return the depth of the cut with a description, once it was published, m."""
        for message in self._cuts.take_all():
            for status in message.status:
                if status.message == text:
                    return next(float(item.value) for item in status.values if item.key == "depth_m")
        return None

    def _call[Response](self, service: Client, request: object, kind: type[Response]) -> Response:
        """Return the answer, of a kind, to a request."""
        name = service.srv_name.rpartition("/")[2]
        self._wait(service.service_is_ready, name)
        pending = service.call_async(request)

        def answer() -> Response | None:
            self._executor.spin_once(timeout_sec=0.0)
            return pending.result() if pending.done() else None

        return self._wait(answer, name)

    def _wait[Answer](self, ask: Callable[[], Answer | None], name: str) -> Answer:
        found = client.wait_until(ask, self._longest, self._stop)
        if found is None or found is False:
            raise UserError(f"no answer from {self._below}{name} within {self._longest:g} s; choose --wait longer")
        return found
