"""A hand that presses beside a cut, and has the node make it meanwhile: delay of the answers, and the node's ticks."""

from __future__ import annotations

import math
import time
from typing import NamedTuple

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import WrenchStamped
from nav_msgs.msg import Path
from rcl_interfaces.msg import Parameter, ParameterType
from rcl_interfaces.srv import SetParameters
from rclpy.node import Node
from std_srvs.srv import Trigger

from tissue_sim.array_types import Floats
from tissue_sim.errors import UserError
from tissue_sim.organ.organ import Organ
from tissue_sim.ros.probes.graph import NODE, START_TIME, first_within
from tissue_sim.ros.probes.poke_probe import NodeReport, node_report_of
from tissue_sim.ros.probes.tool_driver import DEPTH, RADIUS, SWING, Hand
from tissue_sim.ros.shared import client
from tissue_sim.ros.shared.cut_path import cut_path
from tissue_sim.ros.shared.executors import make_executor
from tissue_sim.ros.shared.qos import RELIABLE

PATIENCE = 2.0  # s for an answer to a pose, after which it counts as lost
FORCE_PERIOD = 0.2  # s in which the hand presses more and less
BEFORE, AFTER = 0.5, 1.5  # s of poses before the service is called, and after its answer
REPORT_TIME = 5.0  # s for the node's report, which comes once a second
FROM = 0.02  # m from the surface, where an approach begins


class CutPlace(NamedTuple):
    """A cut, and where a hand presses beside it."""

    polyline: Floats  # (m, 3) m
    direction: Floats  # (3,) of length 1
    depth: float  # m
    touch: Floats  # (3,) m, on the surface
    inward: Floats  # (3,) of length 1, there


class Window(NamedTuple):
    """What was measured in some time of pressing."""

    delays: Floats  # (k,) s from each pose to its answer; PATIENCE where none came
    reports: list[NodeReport]  # of every second that begins or ends in this time, and the one before
    answer: str = ""  # of the service
    took: float = 0.0  # s until that


class CutProbe(Hand):
    """A hand that sends each pose when the last was answered, but no more than a rate; it calls the node's services.

    organ: the node's organ; rate: poses per second, at most, Hz.
    """

    def __init__(self, node: Node, organ: Organ, rate: float) -> None:
        super().__init__(node, organ, rate)
        self._clock = node.get_clock()
        self._answered, self._answer_clock = 0, 0.0
        self._received: list[NodeReport] = []
        node.create_subscription(WrenchStamped, "left/servo_cf", self._on_wrench, client.stream_qos(), raw=True)
        node.create_subscription(DiagnosticArray, "/diagnostics", self._on_report, 10)
        self._path = node.create_publisher(Path, f"/{NODE}/cut_path", RELIABLE)
        self._services = {
            name: node.create_client(kind, f"/{NODE}/{name}")
            for name, kind in (("cut", Trigger), ("reset", Trigger), ("set_parameters", SetParameters))
        }
        self._executor = make_executor()
        self._executor.add_node(node)

    def meet(self) -> None:
        """Wait until the node hears the hand. Raises UserError when it doesn't."""
        super().meet()
        first_within(self._path.get_subscription_count, START_TIME, "the node was not found over DDS")
        for name, service in self._services.items():
            first_within(service.service_is_ready, START_TIME, f"the node's service {name} was not found over DDS")

    def press(self, place: CutPlace) -> None:
        """Reset the organ, which heals it, and press beside where it will be cut."""
        self._call("reset", Trigger.Request())
        self._touch, self._inward = place.touch - RADIUS * place.inward, place.inward
        for depth in np.linspace(-FROM, DEPTH, 400):
            self._delay(float(depth))

    def hold(self, seconds: float) -> Window:
        """Press for some time, s."""
        return self._window(seconds, None)

    def cut(self, place: CutPlace) -> Window:
        """Press from a while before the service is called until a while after its answer.

        Raises UserError when the node doesn't cut.
        """
        value = Parameter(name="cut_depth")
        value.value.type, value.value.double_value = ParameterType.PARAMETER_DOUBLE, place.depth
        self._call("set_parameters", SetParameters.Request(parameters=[value]))
        self._path.publish(cut_path(place.polyline, place.direction, "organ"))
        found = self._window(AFTER, Trigger.Request())
        if not found.answer:
            raise UserError(f"the node made no cut within {START_TIME:g} s")
        return found

    def _window(self, seconds: float, request: Trigger.Request | None) -> Window:
        """Press and measure, if there is a request until so long after its answer; reports of all that are awaited."""
        self._next_report()
        del self._received[:-1]
        delays, asked, end = [], None, math.inf
        began = time.monotonic()
        called = began + BEFORE
        if request is None:
            end = began + seconds
        answer, took = "", 0.0
        while (now := time.monotonic()) < min(end, began + START_TIME):
            if request is not None and asked is None and now >= called:
                called, asked = now, self._services["cut"].call_async(request)
            if asked is not None and asked.done() and not answer:
                answer, took, end = _cut_answer(asked.result()), now - called, now + seconds
            delays.append(self._delay(DEPTH + SWING * math.sin(2.0 * math.pi * (now - began) / FORCE_PERIOD)))
        self._next_report()
        return Window(np.array(delays), list(self._received), answer, took)

    def _next_report(self) -> None:
        """Press on until the node's next report."""
        count, end = len(self._received), time.monotonic() + REPORT_TIME
        while len(self._received) == count:
            if time.monotonic() > end:
                raise UserError(f"the node sent no diagnostics for {REPORT_TIME:g} s")
            self._delay(DEPTH)

    def _delay(self, depth: float) -> float:
        """Send a pose and wait for its answer, and for the time of the next pose; return the delay, s."""
        self._answered = 0
        sent = time.monotonic()
        self.send(depth)
        while not self._answered and time.monotonic() - sent < PATIENCE:
            self._executor.spin_once(timeout_sec=PATIENCE)
        took = self._answer_clock - sent if self._answered else PATIENCE
        while (left := sent + self._period - time.monotonic()) > 0.0:
            self._executor.spin_once(timeout_sec=left)
        return took

    def _call(self, name: str, request: Trigger.Request | SetParameters.Request) -> None:
        """Call a service of the node, and press on until it has answered."""
        pending = self._services[name].call_async(request)
        first_within(
            lambda: self._executor.spin_once(timeout_sec=self._period) or pending.done(),  # type: ignore[func-returns-value]
            START_TIME,
            f"the node's service {name} did not answer",
        )

    def _on_wrench(self, _: bytes) -> None:
        self._answer_clock = time.monotonic()
        self._answered += 1

    def _on_report(self, message: DiagnosticArray) -> None:
        values = client.physics_status([message], NODE)
        if values is not None:
            self._received.append(node_report_of(message.header.stamp, values))


def _cut_answer(answer: Trigger.Response) -> str:
    """Return what the node says about its cut; raise UserError when it made none."""
    if not answer.success:
        raise UserError(f"the node made no cut: {answer.message}")
    return str(answer.message)
