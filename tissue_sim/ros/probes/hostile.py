"""A hostile client: sends a node what no bridge and no person would mean, and checks what comes back."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, WrenchStamped
from rcl_interfaces.srv import GetParameters, ListParameters, SetParameters
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState, PointCloud2
from std_srvs.srv import Trigger

from tissue_sim.array_types import Floats
from tissue_sim.organ.organ import Organ
from tissue_sim.ros.shared import client
from tissue_sim.ros.shared.cdr import parse_stamped
from tissue_sim.ros.shared.parameters import NODE_SPECS
from tissue_sim.ros.shared.report import STARVED

Rng = np.random.Generator
TOOLS = ("left", "right", "jaws")
SECONDS = 0.25  # duration of an act
PATIENCE = 10.0  # s for an answer that a live node gives at once
QUIET, STARVED_QUIET = 0.15, 1.0  # s without a wrench that count as silence: usually, and before a zero
ALL = QoSProfile(depth=4000, reliability=ReliabilityPolicy.BEST_EFFORT, durability=DurabilityPolicy.VOLATILE)
STREAM = client.stream_qos()
KEPT = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.VOLATILE)
LIVE = {spec.name: spec for spec in NODE_SPECS if spec.live and not spec.name.startswith("record")}
USUAL_CLAMP, HIGHEST_CLAMP = float(LIVE["force_clamp"].default), float(LIVE["force_clamp"].high or 0.0)


class Fault(Exception):
    """A promise that a node has broken, in one line."""


class Hostile:
    """Client that sends what acts (hostile_acts) request to the node `target`, and checks it; methods raise Fault.

    Parameters
    ----------
    node : Node
        The rclpy node that sends.
    target : str
        Name of the node that is tested.
    organs : Mapping[str, Organ]
        The organs by name, in their places in the scene that it serves, which follows `~/respiration`; a single one has
        no name.
    """

    def __init__(self, node: Node, target: str, organs: Mapping[str, Organ]) -> None:
        self.node, self.target = node, target
        rest = {name: organ.surface_positions for name, organ in organs.items()}
        points = self.rest = np.concatenate(list(rest.values()))
        self._low, self._high, self.middle = points.min(axis=0), points.max(axis=0), points.mean(axis=0)
        self.poses = {tool: node.create_publisher(PoseStamped, f"{tool}/measured_cp", KEPT) for tool in TOOLS}
        self.forces = {tool: node.create_publisher(WrenchStamped, f"{tool}/external_cf", KEPT) for tool in TOOLS}
        self.angles = node.create_publisher(JointState, "jaws/gripper/measured_js", KEPT)
        self.breath = node.create_publisher(JointState, f"/{target}/respiration", KEPT) if len(organs) > 1 else None
        self._wrenches = {
            tool: client.NewestMessage(node, WrenchStamped, f"{tool}/servo_cf", ALL, raw=True) for tool in TOOLS
        }
        self._reports = client.NewestMessage(node, DiagnosticArray, "/diagnostics", QoSProfile(depth=10))
        self._surfaces = [
            (
                surface,
                client.NewestMessage(node, PointCloud2, "/".join(filter(None, ("", target, name, "surface"))), STREAM),
            )
            for name, surface in rest.items()
        ]
        services = {
            "reset": Trigger,
            "set_parameters": SetParameters,
            "get_parameters": GetParameters,
            "list_parameters": ListParameters,
        }
        asking = client.node_beside(node, "services")  # what is spun would take the inboxes' messages
        self._services = {name: asking.create_client(kind, f"/{target}/{name}") for name, kind in services.items()}
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(asking)
        self._report: dict[str, str] = {}
        self._stands, self.starved = False, 0  # by the newest report; number of such reports
        self._stamp, self.clamp = 0, HIGHEST_CLAMP
        self.felt, self.wrenches = 0.0, 0  # N, the highest so far; number of wrenches

    def meet(self) -> None:
        """Wait until the node hears and answers.

        Raises
        ------
        Fault
            When it doesn't.
        """
        heard = [*self.poses.values(), *self.forces.values(), *filter(None, (self.angles, self.breath))]
        ready = self._services.values()
        if not client.wait_until(
            lambda: all(one.get_subscription_count() for one in heard) and all(s.service_is_ready() for s in ready),
            30.0,
        ):
            raise Fault("the node was not found over DDS")
        self.return_to_default_settings()

    # what acts send ------------------------------------------------------------------------------
    def during(self, period: float, act: Callable[[], object]) -> None:
        """Act for SECONDS.

        Parameters
        ----------
        period : float, s
            Pause after each time.
        act : Callable[[], object]
            The act.
        """
        end = time.monotonic() + SECONDS
        while time.monotonic() < end:
            act()
            if period:
                time.sleep(period)

    def _now(self) -> int:
        self._stamp = max(self._stamp + 1, int(self.node.get_clock().now().nanoseconds))
        return self._stamp

    def pose(self, position: Any, quaternion: Any, stamp: int | None = None, frame: str = "organ") -> PoseStamped:
        """Return a pose of m and a quaternion xyzw.

        Parameters
        ----------
        position : Any, shape (3,), m
            Its position.
        quaternion : Any, shape (4,)
            Its rotation xyzw.
        stamp : int | None, ns, optional
            Its time; now unless given.
        frame : str, optional
            Its frame.
        """
        message = PoseStamped()
        message.header.frame_id = frame
        stamp = self._now() if stamp is None else stamp
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, 1_000_000_000)
        at, turn = message.pose.position, message.pose.orientation
        at.x, at.y, at.z = map(float, position)
        turn.x, turn.y, turn.z, turn.w = map(float, quaternion)
        return message

    def force(self, force: Any, frame: str = "organ") -> WrenchStamped:
        """Return a force of now.

        Parameters
        ----------
        force : Any, shape (3,), N
            The force.
        frame : str, optional
            Its frame.
        """
        message = WrenchStamped()
        message.header.frame_id = frame
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(self._now(), 1_000_000_000)
        message.wrench.force.x, message.wrench.force.y, message.wrench.force.z = map(float, force)
        return message

    def open_jaws(self, angle: float) -> None:
        """Send an angle between the jaws.

        Parameters
        ----------
        angle : float, rad
            The angle.
        """
        self.angles.publish(JointState(name=["jaw"], position=[angle]))

    def respiration(self, shares: list[float], stamp: int | None = None) -> JointState:
        """Return fractions of the breath's way, of which the first counts.

        Parameters
        ----------
        shares : list[float]
            The fractions.
        stamp : int | None, ns, optional
            Its time; now unless given.
        """
        message = JointState(name=["breath"], position=shares)
        stamp = self._now() if stamp is None else stamp
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, 1_000_000_000)
        return message

    def somewhere(self, rng: Rng) -> Floats:
        """Return a place in the organ's box, or 20 mm around it.

        Parameters
        ----------
        rng : Rng
            Draws it.

        Returns
        -------
        Floats
            shape (3,), m
        """
        return np.asarray(rng.uniform(self._low - 0.02, self._high + 0.02))

    # afterwards ------------------------------------------------------------------------------------
    def return_to_default_settings(self) -> dict[str, str]:
        """Restore the initial settings; check that no force is left and that it answers; return its report.

        Raises
        ------
        Fault
            When it fails.
        """
        usual = [Parameter(name, value=spec.default).to_parameter_msg() for name, spec in LIVE.items()]
        answer = self.call("set_parameters", SetParameters.Request(parameters=usual))
        if refused := [result.reason for result in answer.results if not result.successful]:
            raise Fault(f"the default settings are refused: {refused[0]}")
        self.look()
        self._faded()
        self._answers()
        if not self.call("reset", Trigger.Request()).success:
            raise Fault("it can't be reset")
        return self._told()

    def look(self) -> None:
        """Check that all wrenches are finite and within the clamp, and that surfaces are finite and near.

        Raises
        ------
        Fault
            When they aren't.
        """
        for tool in TOOLS:
            self._take(tool)
        for rest, surfaces in self._surfaces:
            for cloud in surfaces.take_all():
                points = client.cloud_array(cloud)[:, :3]
                if not np.all(np.isfinite(points)):
                    raise Fault("a surface that is not finite")
                if np.abs(points - rest).max() > 1.0:
                    raise Fault("a surface more than 1 m away")

    def _take(self, tool: str) -> Floats | None:
        """Return the newest of a tool's wrenches (6,), None where none came; raise Fault for an invalid one."""
        wrench = None
        for raw in self._wrenches[tool].take_all():
            wrench = np.array(parse_stamped(bytes(raw), 6).values)
            if not np.all(np.isfinite(wrench)):
                raise Fault(f"a wrench of '{tool}' that is not finite")
            felt, self.wrenches = float(np.linalg.norm(wrench[:3])), self.wrenches + 1
            self.felt = max(self.felt, felt)
            if felt > self.clamp * (1.0 + 1e-9):
                raise Fault(f"a wrench of '{tool}' of {felt:.3g} N")
        return wrench

    def _faded(self) -> None:
        """Check that tools that send nothing feel nothing: no wrench comes any more, and the last one was zero."""
        last = dict.fromkeys(TOOLS, 0.0)
        quiet = begun = time.monotonic()
        while time.monotonic() - quiet < (STARVED_QUIET if any(last.values()) else QUIET):
            for tool in TOOLS:
                if (wrench := self._take(tool)) is not None:
                    last[tool] = float(np.abs(wrench).max())
                    quiet = time.monotonic()
            if time.monotonic() - begun > PATIENCE:
                raise Fault(f"wrenches {PATIENCE:g} s after the last pose")
            time.sleep(0.01)
        if standing := [tool for tool, size in last.items() if size > 0.0]:
            raise Fault(f"a force of {last[standing[0]]:.3g} N remains for '{standing[0]}', whose poses have stopped")

    def _answers(self) -> None:
        """Check that a pose far away is answered by zero; a node that stood still may answer earlier ones first."""
        begun, first = time.monotonic(), 0.0
        while time.monotonic() - begun < PATIENCE:
            self.poses["left"].publish(self.pose(self.middle + 1.0, (0, 0, 0, 1)))
            time.sleep(0.005)
            if (wrench := self._take("left")) is not None:
                if not wrench.any():
                    return
                first = first or time.monotonic()
                if time.monotonic() - first > STARVED_QUIET:
                    raise Fault("there is a force on a tool a metre away")
        raise Fault(f"no pose was answered for {PATIENCE:g} s")

    def _told(self) -> dict[str, str]:
        """Return the newest report; empty before the first; raise Fault for one of a failure.

        A loop that got no time to run on a busy machine has to go on by the next reports.
        """
        end = time.monotonic() + PATIENCE
        while self._hear_reports():
            if time.monotonic() > end:
                raise Fault(f"it reports a failure for {PATIENCE:g} s: {STARVED}")
            time.sleep(0.05)
        return self._report

    def _hear_reports(self) -> bool:
        """Take the reports that have come; return whether the loop stood still by the newest."""
        for message in self._reports.take_all():
            status = client.newest_status([message], self.target)
            if status is None:
                continue
            self._stands = status.level == b"\x02" and status.message == STARVED
            if self._stands:
                self.starved += 1
                continue
            if status.level == b"\x02":
                raise Fault(f"it reports a failure: {status.message}")
            values = {item.key: item.value for item in status.values}
            failures = [key for key, value in values.items() if "_failures" in key and value not in ("0", "")]
            if failures:
                raise Fault(f"it reports {failures[-1]}: {values[failures[-1]]}")
            self._report = values
        return self._stands

    def call(self, name: str, request: Any) -> Any:
        """Return the answer of a service of the node.

        Parameters
        ----------
        name : str
            The service.
        request : Any
            The request.

        Raises
        ------
        Fault
            When it doesn't answer.
        """
        service, end = self._services[name], time.monotonic() + PATIENCE
        pending = service.call_async(request)
        while not pending.done():
            self._executor.spin_once(timeout_sec=0.05)
            if time.monotonic() > end:
                service.remove_pending_request(pending)
                raise Fault(f"no answer from ~/{name} in {PATIENCE:g} s")
        return pending.result()
