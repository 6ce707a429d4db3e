"""Sends a node what no bridge and no person would mean, and looks at what comes back."""

from __future__ import annotations

import struct
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, WrenchStamped
from rcl_interfaces.srv import GetParameters, ListParameters, SetParameters
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState, PointCloud2
from std_srvs.srv import Trigger
from visualization_msgs.msg import MarkerArray

from tissue_sim.array_types import Floats
from tissue_sim.organ.organ import Organ
from tissue_sim.ros.shared import client
from tissue_sim.ros.shared.cdr import parse_stamped
from tissue_sim.ros.shared.parameters import NODE_SPECS, TOOL_SPECS

Rng = np.random.Generator
TOOLS = ("left", "right", "jaws")
SECONDS = 0.25  # that an act lasts
PATIENCE = 10.0  # s for what a node that lives answers at once
ALL = QoSProfile(depth=4000, reliability=ReliabilityPolicy.BEST_EFFORT, durability=DurabilityPolicy.VOLATILE)
KEPT = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.VOLATILE)
LIVE = {spec.name: spec for spec in NODE_SPECS if spec.live and not spec.name.startswith("record")}
USUAL_CLAMP, HIGHEST_CLAMP = float(LIVE["force_clamp"].default), float(LIVE["force_clamp"].high or 0.0)
WORST = (np.nan, np.inf, -np.inf, 5e-324, -1e308, 1e308, 1e9, 0.0, -0.0, 1e-300)


class Fault(Exception):
    """What a node promises and has not done, in one line."""


class Hostile:
    """Plays acts, each of a name in `ACTS`, and checks the node `target` afterwards. Raises Fault."""

    def __init__(self, node: Node, target: str, organ: Organ) -> None:
        self._node, self._target = node, target
        points = organ.surface_positions
        self._low, self._high, self._middle = points.min(axis=0), points.max(axis=0), points.mean(axis=0)
        self._surface_rest = points
        self._poses = {tool: node.create_publisher(PoseStamped, f"{tool}/measured_cp", KEPT) for tool in TOOLS}
        self._forces = {tool: node.create_publisher(WrenchStamped, f"{tool}/measured_cf", KEPT) for tool in TOOLS}
        self._angles = node.create_publisher(JointState, "jaws/gripper/measured_js", KEPT)
        self._wrenches = {tool: client.Inbox(node, WrenchStamped, f"{tool}/servo_cf", ALL, raw=True) for tool in TOOLS}
        self._reports = client.Inbox(node, DiagnosticArray, "/diagnostics", QoSProfile(depth=10))
        self._surfaces = client.Inbox(node, PointCloud2, f"/{target}/surface", client.stream_qos())
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
        self._stamp, self._clamp = 0, HIGHEST_CLAMP
        self.felt, self.wrenches = 0.0, 0  # N, the highest so far; how many came

    def meet(self) -> None:
        """Wait until the node hears and answers. Raises Fault."""
        heard = [*self._poses.values(), *self._forces.values(), self._angles]
        ready = self._services.values()
        if not client.wait_until(
            lambda: all(one.get_subscription_count() for one in heard) and all(s.service_is_ready() for s in ready),
            30.0,
        ):
            raise Fault("the node was not found over DDS")
        self.calm_down()

    # acts ------------------------------------------------------------------------------------------
    def play(self, rng: Rng, acts: list[str]) -> None:
        """Play acts, one after the other."""
        self._clamp = USUAL_CLAMP
        for act in acts:
            if act == "sets parameters":
                self._clamp = HIGHEST_CLAMP
            ACTS[act](self, rng)
            self._look()

    def _during(self, period: float, act: Callable[[], object]) -> None:
        end = time.monotonic() + SECONDS
        while time.monotonic() < end:
            act()
            if period:
                time.sleep(period)

    def _now(self) -> int:
        self._stamp = max(self._stamp + 1, int(self._node.get_clock().now().nanoseconds))
        return self._stamp

    def _pose(self, position: Any, quaternion: Any, stamp: int | None = None, frame: str = "organ") -> PoseStamped:
        message = PoseStamped()
        message.header.frame_id = frame
        stamp = self._now() if stamp is None else stamp
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, 1_000_000_000)
        at, turn = message.pose.position, message.pose.orientation
        at.x, at.y, at.z = map(float, position)
        turn.x, turn.y, turn.z, turn.w = map(float, quaternion)
        return message

    def _force(self, force: Any, frame: str = "organ") -> WrenchStamped:
        message = WrenchStamped()
        message.header.frame_id = frame
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(self._now(), 1_000_000_000)
        message.wrench.force.x, message.wrench.force.y, message.wrench.force.z = map(float, force)
        return message

    def _jaws(self, angle: float) -> None:
        self._angles.publish(JointState(name=["jaw"], position=[angle]))

    def _somewhere(self, rng: Rng) -> Floats:
        return np.asarray(rng.uniform(self._low - 0.02, self._high + 0.02))

    def _teleport(self, rng: Rng) -> None:
        def act() -> None:
            for tool in TOOLS:
                self._poses[tool].publish(self._pose(self._somewhere(rng), _turn(rng)))

        self._during(0.001, act)

    def _spin(self, rng: Rng) -> None:
        at = self._surface_rest[rng.integers(len(self._surface_rest))]

        def act() -> None:
            for tool in TOOLS:
                self._poses[tool].publish(self._pose(at, _turn(rng)))

        self._during(0.001, act)

    def _race(self, rng: Rng) -> None:
        """A hundred times as fast as a hand."""
        speed, way, begun = rng.uniform(5.0, 50.0), _turn(rng)[:3], time.monotonic()

        def act() -> None:
            at = self._middle + 0.1 * np.sin(speed * 10.0 * (time.monotonic() - begun)) * way
            self._poses["left"].publish(self._pose(at, (0, 0, 0, 1)))
            self._poses["right"].publish(self._pose(at + 0.01, (0, 0, 0, 1)))

        self._during(0.001, act)

    def _inside(self, rng: Rng) -> None:
        at = self._middle + rng.uniform(-0.005, 0.005, size=3)

        def act() -> None:
            for tool in TOOLS:
                self._poses[tool].publish(self._pose(at, (0, 0, 0, 1)))

        self._during(0.002, act)

    def _snap(self, rng: Rng) -> None:
        """Jaws through each other, and open beyond all measure, around tissue."""
        at = self._surface_rest[rng.integers(len(self._surface_rest))]

        def act() -> None:
            self._jaws(float(rng.choice([-10.0, -0.5, 0.0, 0.5, 7.0, np.nan, np.inf, 1e300])))
            self._poses["jaws"].publish(self._pose(at, (0, 0, 0, 1)))

        self._during(0.001, act)

    def _push(self, rng: Rng) -> None:
        """Forces up to 1e9 N, at a tip that touches, that fall at once."""
        at, size = self._surface_rest[rng.integers(len(self._surface_rest))], 10.0 ** rng.uniform(0.0, 9.0)

        def act() -> None:
            for tool in TOOLS:
                self._poses[tool].publish(self._pose(at, (0, 0, 0, 1)))
                self._forces[tool].publish(self._force(size * rng.normal(size=3)))

        self._during(0.002, act)

    def _nonsense(self, rng: Rng) -> None:
        """Numbers that are none, or hardly any."""

        def act() -> None:
            tool, numbers = rng.choice(TOOLS), self._somewhere(rng)
            numbers[rng.integers(3)] = rng.choice(WORST)
            turn = _turn(rng)
            if rng.random() < 0.5:
                turn = rng.choice(WORST, size=4)
            self._poses[tool].publish(self._pose(numbers, turn))
            self._forces[tool].publish(self._force(rng.choice(WORST, size=3)))

        self._during(0.001, act)

    def _stamps(self, rng: Rng) -> None:
        """Of the past, of the future, none, and before 1970."""

        def act() -> None:
            stamp = int(rng.choice([0, 1, 10**9, int(time.time() * 1e9), 2**31 * 10**9 - 1, -(10**9), -1]))
            stamp += int(rng.integers(-(10**9), 10**9)) * int(stamp > 10**10 and stamp < 2 * 10**18)
            self._poses["left"].publish(self._pose(self._somewhere(rng), (0, 0, 0, 1), stamp))

        self._during(0.001, act)

    def _frames(self, rng: Rng) -> None:
        names = ("", "map", "organ ", "/organ", "x" * 10_000, "\u00fc" * 3000, "a\nb\x1b[31m", "%s%n", "organ/../x")

        def act() -> None:
            frame = str(rng.choice(names))
            self._poses["left"].publish(self._pose(self._somewhere(rng), (0, 0, 0, 1), frame=frame))
            self._forces["left"].publish(self._force((0, 0, 1), frame))

        self._during(0.002, act)

    def _flood(self, rng: Rng) -> None:
        """As many as this process can send, on every topic."""
        pose, force = self._pose(self._somewhere(rng), (0, 0, 0, 1)), self._force((0, 0, 0.1))
        poses, forces, angle = serialize_message(pose), serialize_message(force), JointState(position=[0.2])

        def act() -> None:
            for tool in TOOLS:
                for _ in range(20):
                    self._poses[tool].publish(poses)
                    self._forces[tool].publish(forces)
            self._angles.publish(angle)

        self._during(0.0, act)

    def _bytes(self, rng: Rng) -> None:
        """CDR cut short, with lengths that lie, of the other byte order, or no CDR at all."""
        good = [
            (self._poses["left"], serialize_message(self._pose(self._middle, (0, 0, 0, 1)))),
            (self._forces["left"], serialize_message(self._force((0, 0, 1)))),
            (self._angles, serialize_message(JointState(name=["jaw"], position=[0.3]))),
        ]

        def act() -> None:
            publisher, raw = good[rng.integers(len(good))]
            data = bytearray(raw)
            draw = rng.integers(6)
            if draw == 0:
                data = data[: rng.integers(len(data))]
            elif draw == 1:
                struct.pack_into("<I", data, int(rng.choice([12, 16])), int(rng.choice([2**32 - 1, 2**31, 1000, 0])))
            elif draw == 2:
                data[0:4] = bytes(rng.integers(0, 256, size=4, dtype=np.uint8))
            elif draw == 3:
                data = bytearray(rng.bytes(int(rng.integers(0, 2000))))
            else:
                for _ in range(int(rng.integers(1, 20))):
                    data[rng.integers(len(data))] = rng.integers(256)
            publisher.publish(bytes(data))

        self._during(0.0005, act)

    def _parameters(self, rng: Rng) -> None:
        """Values in and out of range, and of other types, of every parameter; several at once."""
        names = [*LIVE, *(f"{tool}.{spec.name}" for tool in TOOLS for spec in TOOL_SPECS), "rate", "model", "nothing"]
        strange = (True, -1, 0, 10**12, 1.0, 1e308, float("nan"), "", "x" * 10_000, [1.0, 2.0], ["a"], [True], b"\0")

        def act() -> None:
            asked = []
            for name in rng.choice(names, size=rng.integers(1, 5)):
                spec = LIVE.get(str(name))
                if spec is not None and spec.low is not None and spec.high is not None and rng.random() < 0.6:
                    value: Any = type(spec.default)(rng.uniform(spec.low, spec.high))
                else:
                    value = strange[rng.integers(len(strange))]
                value = [value] if isinstance(value, bytes) else value
                asked.append(Parameter(str(name), value=value).to_parameter_msg())
            self._call("set_parameters", SetParameters.Request(parameters=asked))

        self._during(0.0, act)

    def _ask(self, rng: Rng) -> None:
        """Services in the middle of a touch."""

        def act() -> None:
            self._poses["left"].publish(self._pose(self._somewhere(rng), (0, 0, 0, 1)))
            name = str(rng.choice(["reset", "list_parameters", "get_parameters"]))
            requests = {
                "reset": Trigger.Request(),
                "list_parameters": ListParameters.Request(prefixes=["x" * 1000], depth=2**40),
                "get_parameters": GetParameters.Request(names=["nothing", "", "tools"] * 20),
            }
            self._call(name, requests[name])

        self._during(0.0, act)

    def _never_read(self, rng: Rng) -> None:
        """Subscribers that are told everything, and take nothing."""
        deep = QoSProfile(depth=1000, reliability=ReliabilityPolicy.RELIABLE)
        latched = QoSProfile(
            depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL
        )
        lazy = [
            client.Inbox(self._node, MarkerArray, f"/{self._target}/markers", latched),
            client.Inbox(self._node, WrenchStamped, "left/servo_cf", client.stream_qos()),
            client.Inbox(self._node, DiagnosticArray, "/diagnostics", deep),
        ]
        self._race(rng)
        for inbox in lazy:
            inbox.close()

    # afterwards ------------------------------------------------------------------------------------
    def calm_down(self) -> dict[str, str]:
        """Have the settings that it began with; then no force is left, and it answers. Returns what it reports."""
        usual = [Parameter(name, value=spec.default).to_parameter_msg() for name, spec in LIVE.items()]
        answer = self._call("set_parameters", SetParameters.Request(parameters=usual))
        if refused := [result.reason for result in answer.results if not result.successful]:
            raise Fault(f"the usual settings are refused: {refused[0]}")
        self._look()
        self._faded()
        self._answers()
        if not self._call("reset", Trigger.Request()).success:
            raise Fault("it can't be reset")
        return self._told()

    def _look(self) -> None:
        """All wrenches that came are finite and within the clamp; surfaces, finite and near."""
        for tool, inbox in self._wrenches.items():
            for raw in inbox.take_all():
                wrench = np.array(parse_stamped(bytes(raw), 6).values)
                if not np.all(np.isfinite(wrench)):
                    raise Fault(f"a wrench of '{tool}' that is not finite")
                felt, self.wrenches = float(np.linalg.norm(wrench[:3])), self.wrenches + 1
                self.felt = max(self.felt, felt)
                if felt > self._clamp * (1.0 + 1e-9):
                    raise Fault(f"a wrench of '{tool}' of {felt:.3g} N")
        for cloud in self._surfaces.take_all():
            points = client.cloud_array(cloud)[:, :3]
            if not np.all(np.isfinite(points)):
                raise Fault("a surface that is not finite")
            if np.abs(points - self._surface_rest).max() > 1.0:
                raise Fault("a surface more than 1 m away")

    def _faded(self) -> None:
        """Tools that send nothing feel nothing: no wrench comes any more, and the last one was zero."""
        last = dict.fromkeys(TOOLS, 0.0)
        quiet = begun = time.monotonic()
        while time.monotonic() - quiet < 0.15:
            for tool, inbox in self._wrenches.items():
                if raws := inbox.take_all():
                    last[tool] = float(np.abs(parse_stamped(bytes(raws[-1]), 6).values).max())
                    quiet = time.monotonic()
            if time.monotonic() - begun > PATIENCE:
                raise Fault(f"wrenches {PATIENCE:g} s after the last pose")
            time.sleep(0.01)
        if standing := [tool for tool, size in last.items() if size > 0.0]:
            raise Fault(f"a force of {last[standing[0]]:.3g} N stands for '{standing[0]}', whose poses have stopped")

    def _answers(self) -> None:
        """A pose far away is answered, by nothing."""
        begun = time.monotonic()
        while time.monotonic() - begun < PATIENCE:
            self._poses["left"].publish(self._pose(self._middle + 1.0, (0, 0, 0, 1)))
            time.sleep(0.005)
            if raws := self._wrenches["left"].take_all():
                if np.abs(parse_stamped(bytes(raws[-1]), 6).values).max() > 0.0:
                    raise Fault("a tool a metre away feels a force")
                return
        raise Fault(f"no pose was answered for {PATIENCE:g} s")

    def _told(self) -> dict[str, str]:
        """The newest report; empty before the first. Raises Fault where it tells a failure."""
        for message in self._reports.take_all():
            status = client.newest_status([message], self._target)
            if status is None:
                continue
            if status.level == b"\x02":
                raise Fault(f"it tells a failure: {status.message}")
            values = {item.key: item.value for item in status.values}
            failures = [key for key, value in values.items() if "_failures" in key and value not in ("0", "")]
            if failures:
                raise Fault(f"it tells {failures[-1]}: {values[failures[-1]]}")
            self._report = values
        return self._report

    def _call(self, name: str, request: Any) -> Any:
        service, end = self._services[name], time.monotonic() + PATIENCE
        pending = service.call_async(request)
        while not pending.done():
            self._executor.spin_once(timeout_sec=0.05)
            if time.monotonic() > end:
                service.remove_pending_request(pending)
                raise Fault(f"no answer from ~/{name} in {PATIENCE:g} s")
        return pending.result()


def _turn(rng: Rng) -> Floats:
    drawn = rng.normal(size=4)
    return np.asarray(drawn / np.linalg.norm(drawn))


ACTS: dict[str, Callable[[Hostile, Rng], None]] = {
    "teleports": Hostile._teleport,
    "spins": Hostile._spin,
    "races": Hostile._race,
    "is inside": Hostile._inside,
    "snaps": Hostile._snap,
    "pushes": Hostile._push,
    "sends nonsense": Hostile._nonsense,
    "stamps wildly": Hostile._stamps,
    "names frames": Hostile._frames,
    "floods": Hostile._flood,
    "sends bytes": Hostile._bytes,
    "sets parameters": Hostile._parameters,
    "asks": Hostile._ask,
    "never reads": Hostile._never_read,
}
