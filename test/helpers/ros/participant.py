"""What every client of a test has: a ROS context, a node and an executor of its own, in the test's process."""

import time
from collections.abc import Callable

import rclpy
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import SetParametersResult
from rcl_interfaces.srv import SetParameters
from rclpy.client import Client
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter

from helpers.patience import LIMIT
from tissue_sim.ros.shared.client import newest_status

ASK_AGAIN, ASK_AGAIN_FIRST = 4.0, 0.25  # s


class Participant:
    """A node that a test spins by hand, and what it hears of the node `target` on /diagnostics."""

    def __init__(self, name: str, namespace: str = "", target: str = "tissue_sim") -> None:
        self.context = rclpy.Context()
        self.context.init()
        self.node = rclpy.create_node(name, namespace=namespace, context=self.context)
        self.target = f"{namespace}/{target}"  # the full name
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self._clients: dict[str, Client] = {}  # of services, by their names
        self.diagnostics: dict[str, str] = {}
        self.level = b""
        self.message = ""
        self.status_messages: list[str] = []  # every message
        self.reported = 0.0  # s, the stamp of the newest report
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)

    def close(self) -> None:
        self.executor.shutdown()
        self.node.destroy_node()
        self.context.try_shutdown()

    def spin(self, seconds: float) -> None:
        """Hear what comes for a while, however much that is."""
        self.spin_until(lambda: False, seconds)

    def spin_until(self, done: Callable[[], bool], timeout: float = LIMIT) -> bool:
        """Whether something has become true."""
        end = time.monotonic() + timeout
        while not (found := done()) and (left := end - time.monotonic()) > 0.0:
            self.executor.spin_once(timeout_sec=min(left, 0.01))
        return bool(found)

    def hears_no_more(self, heard: list) -> bool:
        """Whether messages that are appended to a list cease: none for 0.3 s, once those under way have come."""

        def is_silent() -> bool:
            heard.clear()
            self.spin(0.3)
            return not heard

        return self.spin_until(is_silent)

    def report(self) -> dict[str, str]:
        """The next diagnostics of the node."""
        self.diagnostics = {}
        assert self.spin_until(lambda: bool(self.diagnostics)), f"{self.target} reports nothing"
        return self.diagnostics

    def call(self, kind: type, name: str, request: object) -> object:
        is_first = name not in self._clients
        if is_first:
            self._clients[name] = self.node.create_client(kind, name)
            assert self._clients[name].wait_for_service(LIMIT), f"no service {name}"
        # A server drops the answer to a client that it has not wholly found yet, which the client can't know: the
        # first request may have to be sent again, and soon.
        asked, patience = [], ASK_AGAIN_FIRST if is_first else ASK_AGAIN
        end = time.monotonic() + LIMIT
        while time.monotonic() < end:
            asked.append(self._clients[name].call_async(request))
            if self.spin_until(lambda: any(future.done() for future in asked), patience):
                return next(future.result() for future in asked if future.done())
            patience = min(2.0 * patience, ASK_AGAIN)
        raise AssertionError(f"no answer from {name}")

    def set_parameter(self, name: str, value: object) -> SetParametersResult:
        request = SetParameters.Request(parameters=[Parameter(name, value=value).to_parameter_msg()])
        return self.call(SetParameters, f"{self.target}/set_parameters", request).results[0]

    def stamp(self, seconds: float | None = None) -> Time:
        """A time in s as messages have it; now when none is given."""
        if seconds is None:
            return self.node.get_clock().now().to_msg()
        return rclpy.time.Time(nanoseconds=int(1e9 * seconds)).to_msg()

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        status = newest_status([message], self.target)
        if status is not None:
            self.diagnostics = {item.key: item.value for item in status.values}
            self.level, self.message = status.level, status.message
            self.status_messages.append(status.message)
            self.reported = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
