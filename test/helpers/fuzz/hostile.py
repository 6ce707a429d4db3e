"""A hostile client: sends a node what no bridge and no person would mean, and checks what comes back."""

import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, WrenchStamped
from numpy.typing import NDArray
from rcl_interfaces.srv import GetParameters, ListParameters, SetParameters
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState, PointCloud2
from std_srvs.srv import Trigger

from tissue_sim.organ.organ import Organ
from tissue_sim.ros.shared import client
from tissue_sim.ros.shared.cdr import parse_stamped
from tissue_sim.ros.shared.parameter_specs import NODE_SPECS
from tissue_sim.ros.shared.report import STARVED

TOOLS = ("left", "right", "jaws")
SECONDS = 0.25  # duration of an act
PATIENCE = 10.0  # s for an answer that a live node gives at once
QUIET, STARVED_QUIET = 0.15, 1.0  # s without a wrench that count as silence: usually, and before a zero
ALL = QoSProfile(depth=4000, reliability=ReliabilityPolicy.BEST_EFFORT, durability=DurabilityPolicy.VOLATILE)
KEPT = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.VOLATILE)
LIVE = {spec.name: spec for spec in NODE_SPECS if spec.live and not spec.name.startswith("record")}
USUAL_CLAMP, HIGHEST_CLAMP = float(LIVE["force_clamp"].default), float(LIVE["force_clamp"].high or 0.0)
SERVICES = {
    "reset": Trigger,
    "set_parameters": SetParameters,
    "get_parameters": GetParameters,
    "list_parameters": ListParameters,
}


class Hostile:
    """Client that sends what acts request to the node `target`, and checks it: an AssertionError names what is wrong.

    Organs come by name, in their places in the scene that the node serves, which follows `~/respiration`; a single one
    has no name.
    """

    def __init__(self, node: Node, target: str, organs: Mapping[str, Organ]) -> None:
        self.node, self.target = node, target
        rest = {name: organ.surface_positions for name, organ in organs.items()}
        self.rest = np.concatenate(list(rest.values()))
        self.middle = self.rest.mean(axis=0)
        self.topics = {f"{tool}/measured_cp": PoseStamped for tool in TOOLS}
        self.topics |= {f"{tool}/external_cf": WrenchStamped for tool in TOOLS}
        self.topics |= {"jaws/gripper/measured_js": JointState}
        if len(organs) > 1:
            self.topics |= {f"/{target}/respiration": JointState}
        self._publishers = {name: node.create_publisher(kind, name, KEPT) for name, kind in self.topics.items()}
        self._wrenches = {
            tool: client.NewestMessage(node, WrenchStamped, f"{tool}/servo_cf", ALL, raw=True) for tool in TOOLS
        }
        self._reports = client.NewestMessage(node, DiagnosticArray, "/diagnostics", QoSProfile(depth=10))
        paths = {name: "/".join(filter(None, ("", target, name, "surface"))) for name in rest}
        self._surfaces = [
            (rest[name], client.NewestMessage(node, PointCloud2, path, client.stream_qos()))
            for name, path in paths.items()
        ]
        asking = client.node_beside(node, "services")  # what is spun would take the inboxes' messages
        self._services = {name: asking.create_client(kind, f"/{target}/{name}") for name, kind in SERVICES.items()}
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(asking)
        self._stands = False  # by the newest report
        self._stamp, self.clamp = 0, HIGHEST_CLAMP

    def meet(self) -> None:
        """Wait until the node hears and answers."""
        publishers, ready = self._publishers.values(), self._services.values()
        found = client.wait_until(
            lambda: (
                all(one.get_subscription_count() for one in publishers) and all(s.service_is_ready() for s in ready)
            ),
            30.0,
        )
        assert found, "the node was not found over DDS"
        self.return_to_default_settings()

    # what acts send ------------------------------------------------------------------------------
    def during(self, period: float, act: Callable[[], object]) -> None:
        """Act for SECONDS, with a pause in s after each time."""
        end = time.monotonic() + SECONDS
        while time.monotonic() < end:
            act()
            if period:
                time.sleep(period)

    def publish(self, topic: str, message: Any) -> None:
        """Send a message, or the bytes of one."""
        self._publishers[topic].publish(message)

    def pose(self, tool: str, position: Any, quaternion: Any = (0, 0, 0, 1), *header: Any) -> None:
        """Send a pose, m and xyzw."""
        message = self.stamped(PoseStamped(), *header)
        at, turn = message.pose.position, message.pose.orientation
        at.x, at.y, at.z = map(float, position)
        turn.x, turn.y, turn.z, turn.w = map(float, quaternion)
        self.publish(f"{tool}/measured_cp", message)

    def force(self, tool: str, force: Any, *header: Any) -> None:
        """Send a force, N."""
        message = self.stamped(WrenchStamped(), *header)
        message.wrench.force.x, message.wrench.force.y, message.wrench.force.z = map(float, force)
        self.publish(f"{tool}/external_cf", message)

    def stamped(self, message: Any, stamp: int | None = None, late: int = 0, frame: str = "organ") -> Any:
        """Return a message with a header: a time, or now, later by so much, ns."""
        if stamp is None:
            self._stamp = max(self._stamp + 1, int(self.node.get_clock().now().nanoseconds))
            stamp = self._stamp
        message.header.frame_id = frame
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp + late, 1_000_000_000)
        return message

    def call(self, name: str, request: Any) -> Any:
        """Return the answer of a service of the node."""
        service, end = self._services[name], time.monotonic() + PATIENCE
        pending = service.call_async(request)
        while not pending.done():
            self._executor.spin_once(timeout_sec=0.05)
            if time.monotonic() > end:
                service.remove_pending_request(pending)
                raise AssertionError(f"no answer from ~/{name} in {PATIENCE:g} s")
        return pending.result()

    # afterwards ------------------------------------------------------------------------------------
    def return_to_default_settings(self) -> None:
        """Restore the initial settings; check that no force is left, that it answers and reports no failure."""
        usual = [Parameter(name, value=spec.default).to_parameter_msg() for name, spec in LIVE.items()]
        answer = self.call("set_parameters", SetParameters.Request(parameters=usual))
        refused = [result.reason for result in answer.results if not result.successful]
        assert not refused, f"the default settings are refused: {refused[0]}"
        self.look()
        self._check_fading()
        self._check_answers()
        assert self.call("reset", Trigger.Request()).success, "it can't be reset"
        self._check_reports()

    def look(self) -> None:
        """Check that all wrenches are finite and within the clamp, and that surfaces are finite and near."""
        for tool in TOOLS:
            self._take(tool)
        for rest, surfaces in self._surfaces:
            for cloud in surfaces.take_all():
                points = client.cloud_array(cloud)[:, :3]
                assert np.all(np.isfinite(points)), "a surface that is not finite"
                assert np.abs(points - rest).max() <= 1.0, "a surface more than 1 m away"

    def _take(self, tool: str) -> NDArray | None:
        """Return the newest of a tool's wrenches (6,), None where none came, after a check of all."""
        wrench = None
        for raw in self._wrenches[tool].take_all():
            wrench = np.array(parse_stamped(bytes(raw), 6).values)
            assert np.all(np.isfinite(wrench)), f"a wrench of '{tool}' that is not finite"
            force = float(np.linalg.norm(wrench[:3]))
            assert force <= self.clamp * (1.0 + 1e-9), f"a wrench of '{tool}' of {force:.3g} N"
        return wrench

    def _check_fading(self) -> None:
        """Check that tools that send nothing feel nothing: no wrench comes any more, and the last one was zero."""
        last = dict.fromkeys(TOOLS, 0.0)
        quiet = begun = time.monotonic()
        while time.monotonic() - quiet < (STARVED_QUIET if any(last.values()) else QUIET):
            for tool in TOOLS:
                if (wrench := self._take(tool)) is not None:
                    last[tool] = float(np.abs(wrench).max())
                    quiet = time.monotonic()
            assert time.monotonic() - begun <= PATIENCE, f"wrenches {PATIENCE:g} s after the last pose"
            time.sleep(0.01)
        standing = {tool: size for tool, size in last.items() if size > 0.0}
        assert not standing, f"forces remain, although poses have stopped: {standing} N"

    def _check_answers(self) -> None:
        """Check that a pose far away is answered by zero; a node that stood still may answer earlier ones first."""
        end, answered = time.monotonic() + PATIENCE, False
        while time.monotonic() < end:
            self.pose("left", self.middle + 1.0)
            time.sleep(0.005)
            if (wrench := self._take("left")) is not None:
                if not wrench.any():
                    return
                answered = True
        wrong = "there is a force on a tool a metre away" if answered else "no pose was answered"
        raise AssertionError(f"{wrong} for {PATIENCE:g} s")

    def _check_reports(self) -> None:
        """Check the newest report; a loop that got no time to run on a busy machine has to go on by the next ones."""
        end = time.monotonic() + PATIENCE
        while self._hear_reports():
            assert time.monotonic() <= end, f"it reports a failure for {PATIENCE:g} s: {STARVED}"
            time.sleep(0.05)

    def _hear_reports(self) -> bool:
        """Take the reports that have come; return whether the loop stood still by the newest."""
        for message in self._reports.take_all():
            status = client.newest_status([message], self.target)
            if status is None:
                continue
            self._stands = status.level == b"\x02" and status.message == STARVED
            if not self._stands:
                assert status.level != b"\x02", f"it reports a failure: {status.message}"
                values = {item.key: item.value for item in status.values}
                failures = {
                    key: value for key, value in values.items() if "_failures" in key and value not in ("0", "")
                }
                assert not failures, f"it reports {failures}"
        return self._stands
