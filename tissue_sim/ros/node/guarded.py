"""A rclpy node whose callbacks may fail: the error is noted, whoever asked gets an answer, and the node goes on.

rclpy's executors let an error of a callback out of the spinning: other events that were waiting are lost with it, and
who called a service waits for ever. So errors are caught before rclpy sees them, its own callbacks' for parameters,
/clock and tf among them, which it makes by the same methods.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rclpy.node import Node

from tissue_sim.ros.shared.report import Mishaps


class GuardedNode(Node):
    """A node with `mishaps`, which notes what its callbacks raise."""

    def __init__(self, name: str) -> None:
        self.mishaps = Mishaps("callback", lambda line: self.get_logger().error(line))
        super().__init__(name)

    def guarded[**P](self, callback: Callable[P, object]) -> Callable[P, None]:
        """A callback whose errors are noted."""

        @wraps(callback)
        def call(*args: P.args, **named: P.kwargs) -> None:
            try:
                callback(*args, **named)
            except Exception as error:  # whatever it is: the node goes on
                self.mishaps.note(error)

        return call

    def create_subscription(self, msg_type: Any, topic: str, callback: Any, *args: Any, **named: Any) -> Any:
        """As rclpy's, guarded."""
        return super().create_subscription(msg_type, topic, self.guarded(callback), *args, **named)

    def create_timer(self, timer_period_sec: float, callback: Any, *args: Any, **named: Any) -> Any:
        """As rclpy's, guarded."""
        return super().create_timer(timer_period_sec, self.guarded(callback), *args, **named)

    def create_service(self, srv_type: Any, srv_name: str, callback: Any, *args: Any, **named: Any) -> Any:
        """As rclpy's, guarded: who called is told that it failed."""

        @wraps(callback)
        def call(request: Any, response: Any) -> Any:
            try:
                return callback(request, response)
            except Exception as error:  # whatever it is: the node goes on
                return failed(type(response)(), request, self.mishaps.note(error))

        return super().create_service(srv_type, srv_name, call, *args, **named)


def failed(response: Any, request: Any, line: str) -> Any:
    """A service's response that says so, as far as its type allows."""
    if hasattr(response, "success"):
        response.success, response.message = False, line
    elif hasattr(response, "results") and hasattr(request, "parameters"):  # one for each parameter
        reason = f"{line}; parameters may have been set all the same"
        response.results = [SetParametersResult(successful=False, reason=reason) for _ in request.parameters]
    elif isinstance(getattr(response, "result", None), SetParametersResult):
        response.result = SetParametersResult(successful=False, reason=line)
    elif hasattr(getattr(response, "result", None), "error_message"):  # of simulation_interfaces
        result = response.result
        result.result, result.error_message = result.RESULT_OPERATION_FAILED, line
    elif hasattr(response, "failure_reason"):
        response.successful, response.failure_reason = False, line
    return response
