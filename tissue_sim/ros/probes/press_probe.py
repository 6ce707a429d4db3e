"""A hand that presses the tool `left` of a running node into its organ, and measures the force."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import WrenchStamped
from rclpy.node import Node
from rclpy.time import Time
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from tissue_sim.array_types import Floats
from tissue_sim.errors import UserError
from tissue_sim.organ.organ import Organ
from tissue_sim.ros.probes.graph import NODE, START_TIME, Graph, first_within, ticks
from tissue_sim.ros.probes.tool_driver import Hand
from tissue_sim.ros.shared import client
from tissue_sim.ros.shared.executors import make_executor

LOOKED_AT = 0.05  # s at the end of a press whose wrenches are averaged
PATIENCE = 2.0  # s for a service to answer, until it is asked again
ANSWERED = 3  # poses outside that the node answers before a press begins: a tool whose first pose is inside is held off


class PressProbe(Hand):
    """A hand that sends poses at a rate, like a haptic bridge: the present one, and none for a moment missed."""

    def __init__(self, node: Node, target: str, organ: Organ) -> None:
        super().__init__(node, organ)
        self._angles = node.create_publisher(JointState, "left/gripper/measured_js", client.stream_qos())
        self._wrenches = client.NewestMessage(node, WrenchStamped, "left/servo_cf", client.stream_qos())
        self._reports = client.NewestMessage(node, DiagnosticArray, "/diagnostics", 10)  # type: ignore[arg-type]
        self._target, self._answers = target, list[tuple[float, Floats]]()  # s, and the force (3,) N that came then
        self._reset = node.create_client(Trigger, f"{target}/reset")
        self._last, self._rate = np.zeros(7), 1.0  # pose of the end of the last press, and its rate, Hz
        self.gap = 0.0  # s, longest between two poses of the last press: the machine's delay of the hand
        self.state = ""  # of the tool, when the node reported it last
        self._since = 0  # ns, from which wrenches count
        self._executor = make_executor()
        self._executor.add_node(node)

    def meet(self) -> None:
        """Wait until the node hears the hand; raise UserError when it doesn't."""
        super().meet()
        first_within(self._reset.service_is_ready, START_TIME, "the node's service was not found over DDS")

    def press(self, poses: Iterable[Floats], rate: float) -> Floats:
        """Reset the organ, send poses (7,) at a rate, Hz; returns the force (3,) N in the end.

        The first pose is repeated until the node has answered it. Raises UserError when it doesn't.
        """
        each = list(poses)
        # A pose inside that arrives after the reset would begin the tool's new life there, and it would be held off.
        for _ in range(ANSWERED):
            self.send_pose(each[0])
            time.sleep(1.0 / rate)
        self.reset()
        self._answers.clear()
        self._since = time.time_ns()  # on a busy machine, wrenches of the press before may still be under way
        self._angles.publish(JointState(name=["jaw"], position=[0.0]))

        def is_answered() -> bool:
            self._send_and_receive(each[0])
            time.sleep(1.0 / rate)
            return len(self._answers) >= ANSWERED

        first_within(is_answered, START_TIME, "no pose was answered")
        began, last, self.gap = time.monotonic(), -1, 0.0
        sent = began
        while (now := int((time.monotonic() - began) * rate)) < len(each):
            if now > last:
                self._send_and_receive(each[now])
                sent, before, last = time.monotonic(), sent, now
                self.gap = max(self.gap, sent - before)
            time.sleep(max(0.0, began + (last + 1) / rate - time.monotonic()))
        self._last, self._rate = each[-1], rate
        return force_in_the_end(self._answers)

    def hold_on(self, ticks: int) -> Floats:
        """Hold the last pose of a press until the loop has done so many more ticks; returns the force (3,) N then.

        Raises UserError when the loop never does them.
        """
        self._reports.take_all()
        done: list[int] = []

        def is_over() -> bool:
            self._send_and_receive(self._last)
            time.sleep(1.0 / self._rate)
            values = client.physics_status(self._reports.take_all(), self._target)
            if values is not None:
                done.append(int(values["tick"]))
                self.state = values.get("left.state", "")
            return len(done) > 0 and done[-1] >= done[0] + ticks

        first_within(is_over, START_TIME, f"the loop did not do {ticks} ticks")
        return force_in_the_end(self._answers)

    def _send_and_receive(self, pose: Floats) -> None:
        """Send a pose (7,), and note the newest wrench that came."""
        self.send_pose(pose)
        message = self._wrenches.take()
        if message is not None and Time.from_msg(message.header.stamp).nanoseconds >= self._since:
            force = message.wrench.force
            self._answers.append((time.monotonic(), np.array([force.x, force.y, force.z])))

    def reset(self) -> None:
        """Bring the organ back to rest, without tools; raise UserError when the node doesn't answer."""
        end = time.monotonic() + START_TIME
        while time.monotonic() < end:
            pending = self._reset.call_async(Trigger.Request())
            self._executor.spin_until_future_complete(pending, PATIENCE)
            if pending.done():
                return
            self._reset.remove_pending_request(pending)
        raise UserError("the node doesn't answer the reset request")


def force_in_the_end(answers: Sequence[tuple[float, Floats]]) -> Floats:
    """Return the mean force (3,) N of the last LOOKED_AT s of wrenches that came, s and N; zero where none did.

    It counts by time, not by their number: on a busy machine few come, and earlier ones would be of another depth.
    """
    if not answers:
        return np.zeros(3)
    return np.asarray(np.mean([force for at, force in answers if at >= answers[-1][0] - LOOKED_AT], axis=0))


@contextmanager
def pressing(organ_file: str, organ: Organ, parameters: Sequence[str]) -> Iterator[PressProbe]:
    """Start a node with an organ of a file and parameters, and a hand at it.

    Raises UserError when the node doesn't start.
    """
    with Graph() as graph:
        served = graph.start_node(organ_file, *parameters)
        ticks(served)
        presser = PressProbe(graph.client("presser"), NODE, organ)
        presser.meet()
        yield presser
