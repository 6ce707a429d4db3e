"""A rclpy node whose callbacks may fail: the error is noted, the caller gets an answer, and the node goes on.

rclpy's executors let an error of a callback end the spinning: other waiting events are lost with it, and the caller of
a service waits for ever. So errors are caught before rclpy sees them, including those of its own callbacks for
parameters, /clock and tf, which it creates by the same methods.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rclpy.event_handler import (
    PublisherEventCallbacks,
    QoSRequestedIncompatibleQoSInfo,
    SubscriptionEventCallbacks,
)
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rclpy.qos import QoSCompatibility, QoSProfile, ReliabilityPolicy, qos_check_compatible
from rclpy.service import Service
from rclpy.subscription import Subscription
from rclpy.timer import Timer

from tissue_sim.ros.shared.report import UnexpectedErrors


class GuardedNode(Node):
    """A node with `unexpected_errors`, which notes what its callbacks raise and reports topics whose QoS doesn't match.

    Attributes
    ----------
    remedies
        How to change the QoS of a topic, by its name in the graph.
    decided
        Returns the result of setting a parameter, or None where rclpy is to decide.
    """

    def __init__(self, name: str) -> None:
        self.unexpected_errors = UnexpectedErrors("callback", lambda line: self.get_logger().error(line))
        self.remedies: dict[str, str] = {}
        self.decided: Callable[[Parameter], SetParametersResult | None] = lambda _: None
        super().__init__(name)

    def set_parameters(self, parameter_list: list[Parameter]) -> list[SetParametersResult]:
        """Set parameters like rclpy, except for those that are decided here."""
        return [self.decided(one) or super(GuardedNode, self).set_parameters([one])[0] for one in parameter_list]

    def set_parameters_atomically(self, parameter_list: list[Parameter]) -> SetParametersResult:
        """Set parameters like rclpy, except for those that are decided here."""
        decided = [(one, self.decided(one)) for one in parameter_list]
        if refused := [result for _, result in decided if result is not None and not result.successful]:
            return refused[0]
        left = [one for one, result in decided if result is None]
        return super().set_parameters_atomically(left) if left else SetParametersResult(successful=True)

    def guarded[**P](self, callback: Callable[P, object]) -> Callable[P, None]:
        """Return a callback whose errors are noted."""

        @wraps(callback)
        def call(*args: P.args, **named: P.kwargs) -> None:
            try:
                callback(*args, **named)
            except Exception as error:  # of any kind: the node goes on
                self.unexpected_errors.note(error)

        return call

    def create_subscription(
        self, msg_type: type, topic: str, callback: Callable[..., object], qos_profile: QoSProfile | int, **named: Any
    ) -> Subscription:
        """Subscribe like rclpy, guarded; warn about publishers that offer less than it requests."""
        warn = self.guarded(lambda event: self._report_qos(topic, qos_profile, event, publishes=False))
        named.setdefault("event_callbacks", SubscriptionEventCallbacks(incompatible_qos=warn))
        return super().create_subscription(msg_type, topic, self.guarded(callback), qos_profile, **named)

    def create_publisher(self, msg_type: type, topic: str, qos_profile: QoSProfile | int, **named: Any) -> Publisher:
        """Publish like rclpy; warn about subscribers that request more than it offers."""
        warn = self.guarded(lambda event: self._report_qos(topic, qos_profile, event, publishes=True))
        named.setdefault("event_callbacks", PublisherEventCallbacks(incompatible_qos=warn))
        return super().create_publisher(msg_type, topic, qos_profile, **named)

    def _report_qos(
        self, topic: str, given: QoSProfile | int, event: QoSRequestedIncompatibleQoSInfo, publishes: bool
    ) -> None:
        """Warn about nodes whose QoS doesn't match, and say what helps."""
        own = QoSProfile(depth=given) if isinstance(given, int) else given
        name = self.resolve_topic_name(topic)
        policy = event.last_policy_kind.name.lower().removeprefix("rmw_qos_policy_")
        ends = (self.get_subscriptions_info_by_topic if publishes else self.get_publishers_info_by_topic)(name)
        pairs = [(own, end.qos_profile) if publishes else (end.qos_profile, own) for end in ends]
        wrong = [
            f"{end.node_namespace.rstrip('/')}/{end.node_name}"
            for end, pair in zip(ends, pairs, strict=True)
            if qos_check_compatible(*pair)[0] == QoSCompatibility.ERROR and "UNKNOWN" not in end.node_name
        ]
        who = ", ".join(sorted(set(wrong))) or "another node"  # it may be found before its name
        is_reliable = own.reliability == ReliabilityPolicy.RELIABLE
        mine, theirs = ("reliable", "best effort") if is_reliable else ("best effort", "reliable")
        remedy = self.remedies.get(name, "")
        if policy != "reliability":
            mine, theirs, remedy = f"one {policy}", "another", ""
        line = f"this node offers {mine}, but {who} requests {theirs}: it receives nothing"
        if not publishes:
            line = f"this node requests {mine}, but {who} offers {theirs}: its messages are not received"
        remedy = remedy or "set the other one to the QoS of this node"
        self.get_logger().warning(f"the QoS on {name} does not match: {line}; {remedy}")

    def create_timer(self, timer_period_sec: float, callback: Callable[..., object], *args: Any, **named: Any) -> Timer:
        """Create a timer like rclpy, guarded."""
        return super().create_timer(timer_period_sec, self.guarded(callback), *args, **named)

    def create_service[Request, Response](
        self, srv_type: type, srv_name: str, callback: Callable[[Request, Response], Response], *args: Any, **named: Any
    ) -> Service:
        """Create a service like rclpy, guarded: the caller learns that it failed."""

        @wraps(callback)
        def call(request: Request, response: Response) -> Response:
            try:
                return callback(request, response)
            except Exception as error:  # of any kind: the node goes on
                return failed(type(response)(), request, self.unexpected_errors.note(error))

        return super().create_service(srv_type, srv_name, call, *args, **named)


def failed[Response](response: Response, request: object, line: str) -> Response:
    """Return a service's response with the failure, as far as its type allows.

    response: the response (updated); line: what failed.
    """
    made: Any = response  # its fields are those of its service
    if hasattr(made, "success"):
        made.success, made.message = False, line
    elif hasattr(made, "results") and hasattr(request, "parameters"):  # one for each parameter
        reason = f"{line}; parameters may have been set nevertheless"
        made.results = [SetParametersResult(successful=False, reason=reason) for _ in request.parameters]
    elif isinstance(getattr(made, "result", None), SetParametersResult):
        made.result = SetParametersResult(successful=False, reason=line)
    elif hasattr(getattr(made, "result", None), "error_message"):  # of simulation_interfaces
        made.result.result, made.result.error_message = made.result.RESULT_OPERATION_FAILED, line
    elif hasattr(made, "failure_reason"):
        made.successful, made.failure_reason = False, line
    return response
