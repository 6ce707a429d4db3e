"""Replay of a recording's inputs to a running node: over DDS, with /clock, tick by tick."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import WrenchStamped
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.time import Time
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import PointCloud2
from shape_msgs.msg import Mesh
from std_srvs.srv import Trigger

from tissue_sim.errors import UserError
from tissue_sim.json_types import JsonObject
from tissue_sim.ros.bags.comparison import Shown
from tissue_sim.ros.bags.differences import Described, differences
from tissue_sim.ros.bags.recording import Recording, tools_of
from tissue_sim.ros.bridge.scripted_tool import ScriptedTool
from tissue_sim.ros.shared import client
from tissue_sim.ros.shared.cdr import parse_stamped
from tissue_sim.ros.shared.node_parameters import NodeParameters
from tissue_sim.ros.shared.tool_link import ToolLink

PATIENCE = 60.0  # s to wait for the node
ANSWERED = 0.02  # s for the node to answer a pose before the next tick is due; a late pose is a tick late
RAN = 0.002  # s for the ticks before a pose
KEEP = QoSProfile(depth=100, reliability=ReliabilityPolicy.BEST_EFFORT)


def play_live(recording: Recording, target: str) -> tuple[list[str], Shown]:
    """Send all inputs to a running node.

    Returns notes, and what the node showed by the recording's ticks. Raises UserError when the node is not there, does
    not follow /clock, or has other tools.
    """
    if recording.is_scene:
        raise UserError("--live needs the bag of a single organ, and this one contains a scene")
    with client.client_node("replay", target) as node:
        return _Live(node, recording, target).play()


class _Live:
    def __init__(self, node: Node, recording: Recording, target: str) -> None:
        self._recording, self._target = recording, target
        self._first = int(recording.first_tick)
        self._period = round(1e9 / recording.config["parameters"]["rate"])  # ns
        self._origin = time.time_ns()  # time of the first tick on /clock
        self._clock = node.create_publisher(Clock, "/clock", QoSProfile(depth=1))
        self._reports = client.NewestMessage(node, DiagnosticArray, "/diagnostics", QoSProfile(depth=10))
        self._meshes = client.NewestMessage(node, Mesh, f"/{target}/mesh", client.latched_qos())
        self._surfaces = client.NewestMessage(node, PointCloud2, f"/{target}/surface", client.stream_qos())
        self._node = node
        self._shapes: dict[int, np.ndarray] = {}
        self._tools: list[ScriptedTool] = []
        self._frames: list[str] = []  # of each tool's poses and forces
        self._wrenches: list[client.NewestMessage] = []
        self._answers: list[dict[int, np.ndarray]] = []
        self._forces: list[Publisher | None] = []
        self._shift: dict[int, int] = {}  # ns from the recording's stamps to those sent, by tool

    def play(self) -> tuple[list[str], Shown]:
        """Connect to the node, and go through the inputs at the pace of the recording, or slower."""
        notes = self._meet()
        inputs = self._inputs()
        begun = time.monotonic()
        for tick in sorted(inputs):
            ahead = begun + 1e-9 * self._period * (tick - self._first) - time.monotonic()
            self._publish_time(tick - 1)
            time.sleep(max(RAN, ahead))
            self._hear()
            for send in inputs[tick]:
                send(self._stamp(tick))
            self._answered()
            self._publish_time(tick)
        time.sleep(ANSWERED)
        self._hear()
        return notes, self._shown()

    # before ------------------------------------------------------------------------------------
    def _meet(self) -> list[str]:
        recording, target = self._recording, self._target
        parameters = NodeParameters(self._node, target)
        mesh = self._wait(self._meshes.take, f"no mesh on /{target}/mesh: start tissue_node, or name yours with --node")
        values = self._wait(parameters.poll, f"no answer from /{target}/get_parameters")
        notes = self._differing(values, client.mesh_arrays(mesh)[0])
        for tool in tools_of(recording.config):
            link = ToolLink.from_parameters(values, tool.name, target)
            if link is None:
                raise UserError(f"/{target} has no tool '{tool.name}', which the bag has")
            if link.topics.wrench_type != "WrenchStamped" or link.topics.turns_wrench or not link.to_organ.is_identity:
                raise UserError(
                    f"--live needs tool '{tool.name}' with WrenchStamped, and poses and wrenches in the organ's frame"
                )
            self._tools.append(ScriptedTool(self._node, link, tool.has_jaws))
            self._frames.append(link.topics.frame_id)
            name = link.topics.names
            self._wrenches.append(client.NewestMessage(self._node, WrenchStamped, name["servo_cf"], KEEP, raw=True))
            self._answers.append({})
            self._forces.append(self._force_publisher(tool.name, name["external_cf"]))
        self._wait(
            lambda: all(tool.has_subscribers for tool in self._tools) or None, "the node does not receive the poses"
        )
        self._wait(self._is_followed, f"/{target} sends nothing on /diagnostics")
        reset = self._node.create_client(Trigger, f"/{target}/reset")
        self._wait(lambda: reset.service_is_ready() or None, f"no service /{target}/reset")
        reset.call_async(Trigger.Request())
        time.sleep(5 * ANSWERED)
        if not self._recording.organs[0].state["status"]["asleep"].item():
            notes.append("the recording begins with the organ in motion, but the node's organ is at rest")
        rows = recording.organs[0].journal["inputs"]
        if len(np.unique(rows["settings"])) > 1 or len(np.unique(rows["resets"])) > 1:
            notes.append("the recording has changes of parameters or resets, which are not sent to the node")
        return notes

    def _force_publisher(self, tool: str, topic: str) -> Publisher | None:
        """Return the publisher of a tool's external forces; None for a tool without."""
        if topic:
            return self._node.create_publisher(WrenchStamped, topic, client.stream_qos())
        if self._recording.forces[len(self._forces)]:
            raise UserError(f"the bag has external forces of tool '{tool}': give the node {tool}.external_cf, a topic")
        return None

    def _differing(self, values: JsonObject, vertices: np.ndarray) -> list[str]:
        recorded = Described.recorded(self._recording.config)
        plain = {name: value if np.isscalar(value) else list(value) for name, value in values.items()}
        known = {name: value for name, value in recorded.parameters.items() if name in plain}
        named = Described(recorded.how, recorded.organ, "", recorded.version, known)
        node = Described(f"/{self._target} has", recorded.organ, "", recorded.version, {n: plain[n] for n in known})
        notes = differences(named, node)
        organ = self._recording.organs[0].organ()
        if not np.array_equal(vertices, organ.surface_positions):
            notes.insert(0, f"organ: recorded {organ.name}, /{self._target} has one of {len(vertices)} surface points")
        return notes

    def _is_followed(self) -> bool | None:
        self._publish_time(self._first)
        status = client.physics_status(self._reports.take_all(), self._target)
        if status is not None and status.get("clock") == "wall":
            raise UserError(f"/{self._target} does not follow /clock: start it with use_sim_time:=true")
        return True if status is not None and status.get("clock", "").startswith("/clock") else None

    def _wait[Answer](self, ask: Callable[[], Answer | None], problem: str) -> Answer:
        found = client.wait_until(ask, PATIENCE)
        if found is None or found is False:
            raise UserError(problem)
        return found

    # meanwhile ---------------------------------------------------------------------------------
    def _stamp(self, tick: int) -> int:
        return self._origin + (tick - self._first) * self._period

    def _publish_time(self, tick: int) -> None:
        self._clock.publish(Clock(clock=Time(nanoseconds=self._stamp(tick)).to_msg()))

    def _inputs(self) -> dict[int, list[Callable[[int], None]]]:
        """Return what is sent before a tick, each for a stamp in ns; what the state had already applied goes first."""
        rows = self._recording.organs[0].journal["inputs"]["tick"]
        bodies = self._recording.organs[0].journal["body_inputs"]
        found: dict[int, list[Callable[[int], None]]] = defaultdict(list)
        body = 0
        for tool, made in enumerate(tools_of(self._recording.config)):
            for kind in ("pose", "force"):
                last = 0
                for tick, number in zip(rows.tolist(), bodies[kind][:, body].tolist(), strict=True):
                    if number != last:
                        at = max(tick, self._first + 1)
                        found[at].append(self._sender(kind, tool, number, at))
                    last = number
            body += made.n_bodies
        return found

    def _sender(self, kind: str, tool: int, number: int, tick: int) -> Callable[[int], None]:
        recording, out = self._recording, self._tools[tool]
        if kind == "force":
            force = recording.forces[tool][number]
            return lambda stamp: self._push(tool, force, stamp)
        pose, angle = recording.poses[tool][number], recording.angles[tool].get(number)
        # With the recorded intervals, since the tool's speed follows from the stamps.
        recorded = recording.stamps[tool][number]
        stamped = recorded + self._shift.setdefault(tool, self._stamp(tick) - recorded)

        def send(stamp: int) -> None:
            if angle is not None:
                out.open(stamp, angle)
                time.sleep(RAN)  # the jaws open with the next pose
            out.publish(stamped, pose)

        return send

    def _push(self, tool: int, force: np.ndarray, stamp: int) -> None:
        publisher, message = self._forces[tool], WrenchStamped()
        message.header.frame_id, message.header.stamp = self._frames[tool], Time(nanoseconds=stamp).to_msg()
        message.wrench.force.x, message.wrench.force.y, message.wrench.force.z = map(float, force)
        if publisher is not None:
            publisher.publish(message)

    def _answered(self) -> None:
        """Wait until a wrench answers; not for long, as one may be lost, and forces have no answer."""
        end = time.monotonic() + ANSWERED
        while not self._hear() and time.monotonic() < end:
            time.sleep(2e-4)

    def _hear(self) -> int:
        received = 0
        for wrenches, inbox in zip(self._answers, self._wrenches, strict=True):
            for raw in inbox.take_all():
                message = parse_stamped(raw, 6)
                wrenches[self._tick(message.stamp)] = np.array(message.values)
                received += 1
        for cloud in self._surfaces.take_all():
            stamp = cloud.header.stamp.sec * 1_000_000_000 + cloud.header.stamp.nanosec
            self._shapes[self._tick(stamp)] = client.cloud_array(cloud)
        return received

    def _tick(self, stamp: int) -> int:
        return self._first + round((stamp - self._origin) / self._period)

    def _shown(self) -> Shown:
        ticks = [np.array(sorted(wrenches), dtype=np.int64) for wrenches in self._answers]
        wrenches = [
            np.array([wrenches[tick] for tick in own.tolist()]).reshape(-1, 6)
            for wrenches, own in zip(self._answers, ticks, strict=True)
        ]
        shapes = np.array(sorted(self._shapes), dtype=np.int64)
        surfaces = [self._shapes[tick][:, :3] for tick in shapes.tolist()] or np.zeros((0, 0, 3))
        names = self._recording.config["tools"]
        return Shown(names, ticks, wrenches, [shapes], [np.array(surfaces, dtype=np.float32)])
