"""`tissue_sim bridge`: a scripted haptic bridge, for demonstrations and for tests."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from tissue_sim.errors import UserError
from tissue_sim.ros import client
from tissue_sim.ros.cdr import parse_stamped
from tissue_sim.ros.script import ACTIONS, SCRIPT

if TYPE_CHECKING:
    from rclpy.node import Node

    from tissue_sim.contact.gripper import Jaws
    from tissue_sim.ros.motion import Path
    from tissue_sim.ros.probing import Floats

TOOLS = ("left", "right")
LOOK_AGAIN = 1.0  # s between two looks for another organ
MATCHING = 3.0  # s, at most, for DDS to bring the tools' topics together


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("--rate", type=client.number(1.0, 2000.0, "Hz"), default=500.0, help="poses a second, Hz")
    parser.add_argument(
        "--seconds", type=client.number(0.01, 1e9, "s"), help="end after this time; without it, go on until Ctrl-C"
    )
    parser.add_argument(
        "--tools",
        type=client.names,
        help="names of the tools; a nip takes the first two, a grip the first gripper"
        f" (default: {','.join(TOOLS)}; of a grip, those of the node)",
    )
    parser.add_argument("--node", type=client.node_name, default="tissue_sim", help="name of the node")
    parser.add_argument("--radius", type=client.number(1e-4, 0.1, "m"), default=0.005, help="of the spherical tools, m")
    parser.add_argument(
        "--script",
        type=_script,
        help=f"what to do, in this order, of {','.join(ACTIONS)}; all but the grip unless given",
    )
    parser.add_argument("--frame", default="organ", help="frame id of the poses")
    parser.add_argument(
        "--wait", type=client.number(0.0, 3600.0, "s"), default=30.0, help="how long to wait for the node, s"
    )


def run(args: argparse.Namespace) -> int:
    """Play the script; returns 0, or 1 when the node's mesh does not come."""
    names: tuple[str, ...] = args.tools or TOOLS
    script = args.script or SCRIPT[: len(SCRIPT) if len(names) > 1 else -1]
    _check(script, names)

    from shape_msgs.msg import Mesh

    from tissue_sim.ros.trajectory import plan

    with client.Stop() as stop, client.client_node("haptic_bridge", args.node) as node:
        jaws: dict[str, Jaws] = {}
        if "grip" in script:
            from tissue_sim.ros.node_parameters import NodeParameters

            values = _wait_until(NodeParameters(args.node).poll, args.wait, stop)
            if values is None:
                return 0 if stop else _not_there(args, f"no answer from /{args.node}/get_parameters")
            names, jaws = grippers(values, args, script)
            _check(script, names)
        tools = [ScriptedTool(node, name, args.frame, name in jaws) for name in names]
        meshes = client.Inbox(node, Mesh, f"/{args.node}/mesh", client.latched_qos())
        mesh = _wait_until(meshes.take, args.wait, stop)
        if mesh is None:
            return 0 if stop else _not_there(args, f"no mesh on /{args.node}/mesh")
        vertices, triangles = client.mesh_arrays(mesh)
        _wait_until(lambda: all(tool.heard for tool in tools), MATCHING, stop)
        player = Player(tools, args.rate, args.seconds)
        while True:
            path = plan(vertices, triangles, args.radius, names, script, jaws)
            print(
                f"organ of {len(vertices)} nodes: {', '.join(script)} in {path.duration:.1f} s, again and again,"
                f" at {args.rate:g} Hz",
                flush=True,
            )
            found = player.play(path, stop, meshes, vertices)
            if found is None:
                break
            vertices, triangles = found
            print("the node has another organ", flush=True)
        peaks = ", ".join(f"{tool.name} {tool.peak:.2f} N" for tool in tools)
        sent, received = sum(tool.sent for tool in tools), sum(tool.received for tool in tools)
        late = f", {player.skipped} skipped" if player.skipped else ""
        print(f"{sent} poses sent{late}, {received} wrenches received, peak force: {peaks}", flush=True)
    return 0


def _script(text: str) -> tuple[str, ...]:
    words = tuple(word.strip() for word in text.split(","))
    for word in words:
        if word not in ACTIONS:
            raise argparse.ArgumentTypeError(f"'{word}' is unknown; choose from {', '.join(ACTIONS)}")
    return words


def _check(script: Sequence[str], names: Sequence[str]) -> None:
    if "nip" in script and len(names) < 2:
        raise UserError("a nip needs two tools: name two with --tools, or leave it out of --script")


def _not_there(args: argparse.Namespace, what: str) -> int:
    sys.stderr.write(f"tissue_sim bridge: {what} in {args.wait:g} s; start tissue_node, or name yours with --node\n")
    return 1


def grippers(
    values: Mapping[str, Any], args: argparse.Namespace, script: Sequence[str]
) -> tuple[tuple[str, ...], dict[str, Jaws]]:
    """The tools to play, and the jaws of those that have some, by a node's parameters."""
    from tissue_sim.ros.parameters import tool_of

    there = tuple(values.get("tools", ()))
    names = args.tools or there
    for name in names:
        if name not in there:
            raise UserError(f"/{args.node} has no tool '{name}'; it has {', '.join(there)}: choose with --tools")
    tools = [tool_of(values, name) for name in names]
    jaws = {tool.name: tool.jaws for tool in tools if tool.shape == "gripper"}
    if not jaws:
        shapes = ", ".join(f"'{tool.name}' is a {tool.shape}" for tool in tools) or "there is none"
        raise UserError(
            f"a grip needs a gripper; on /{args.node} {shapes}: start it with --params-file config/gripper.yaml"
        )
    return (names if args.tools or set(script) != {"grip"} else (next(iter(jaws)),)), jaws


class ScriptedTool:
    """One tool's topics, as a haptic device has them: poses out, the wrench for the hand in."""

    def __init__(self, node: Node, name: str, frame_id: str, has_jaws: bool = False) -> None:
        from geometry_msgs.msg import PoseStamped, WrenchStamped
        from sensor_msgs.msg import JointState

        from tissue_sim.ros.messages import NumbersTemplate

        self.name = name
        self._pose = NumbersTemplate(PoseStamped(), 7, frame_id)
        self._publisher = node.create_publisher(PoseStamped, f"{name}/measured_cp", client.stream_qos())
        self._joint = JointState(name=["jaw"], position=[0.0])
        self._jaws = (
            node.create_publisher(JointState, f"{name}/gripper/measured_js", client.stream_qos()) if has_jaws else None
        )
        self._wrenches = client.Inbox(node, WrenchStamped, f"{name}/servo_cf", client.stream_qos(), raw=True)
        self.sent = self.received = 0
        self.peak = 0.0  # N, largest force so far

    def publish(self, stamp: int, pose: Floats) -> None:
        """Send a pose (7,), position m and quaternion x y z w, with a stamp in ns."""
        self._publisher.publish(self._pose.message(stamp, pose))
        self.sent += 1

    def open(self, stamp: int, angle: float) -> None:
        """Send the angle in rad between the jaws, with a stamp in ns; nothing for a tool without jaws."""
        if self._jaws is None:
            return
        self._joint.header.stamp.sec, self._joint.header.stamp.nanosec = divmod(stamp, 1_000_000_000)
        self._joint.position[0] = angle
        self._jaws.publish(self._joint)

    @property
    def heard(self) -> bool:
        """Whether somebody subscribes to the poses, and to the jaws if there are some."""
        publishers = [self._publisher] if self._jaws is None else [self._publisher, self._jaws]
        return all(publisher.get_subscription_count() for publisher in publishers)

    def feel(self) -> None:
        """Take the newest wrench, if one has come."""
        raw = self._wrenches.take()
        if raw is not None:
            x, y, z = parse_stamped(raw, 6).values[:3]
            self.peak = max(self.peak, (x * x + y * y + z * z) ** 0.5)
            self.received += 1


class Player:
    """Sends a path's poses at absolute deadlines; late ones are left out, so that speeds stay true."""

    def __init__(self, tools: list[ScriptedTool], rate: float, seconds: float | None) -> None:
        self._tools, self._rate = tools, rate
        self._end = None if seconds is None else time.monotonic() + seconds
        self.skipped = 0

    def play(self, path: Path, stop: client.Stop, meshes: client.Inbox, organ: Floats) -> Any:
        """Play a path again and again, until the time is over, a signal asks for it, or the node has another organ.

        Then the tools leave the tissue. Returns the other organ's vertices and triangles, or None.
        """
        cycle = path.sample(self._rate)
        angles = path.sample_jaws(self._rate)
        start, next_look, tick, found = time.monotonic(), time.monotonic() + LOOK_AGAIN, 0, None
        while not stop and found is None:
            now = time.monotonic()
            if self._end is not None and now >= self._end:
                break
            due = int((now - start) * self._rate)
            self.skipped += max(0, due - tick)
            tick = max(tick, due)
            step = tick % len(cycle)
            self._send(cycle[step], angles[step], start + tick / self._rate)
            tick += 1
            if now > next_look:
                next_look = now + LOOK_AGAIN
                found = _other_organ(meshes.take(), organ)
        start, last = time.monotonic(), max(tick - 1, 0) / self._rate
        leaving = zip(path.retreat(last, self._rate), path.retreat_jaws(last, self._rate), strict=True)
        for step, (poses, opened) in enumerate(leaving):
            self._send(poses, opened, start + step / self._rate)
        return found

    def _send(self, poses: Floats, angles: Floats, deadline: float) -> None:
        if (ahead := deadline - time.monotonic()) > 0.0:
            time.sleep(ahead)
        stamp = time.time_ns()
        for tool, angle in zip(self._tools, angles, strict=True):  # first: the node opens the jaws with the next pose
            tool.open(stamp, float(angle))
        for tool, pose in zip(self._tools, poses, strict=True):
            tool.publish(stamp, pose)
        for tool in self._tools:
            tool.feel()


def _wait_until(ask: Callable[[], Any], longest: float, stop: client.Stop) -> Any:
    """Ask until the answer is neither None nor False; what it is then, or after `longest` s."""
    end = time.monotonic() + longest
    while (answer := ask()) in (None, False) and not stop and time.monotonic() < end:
        time.sleep(0.02)
    return answer


def _other_organ(mesh: Any, organ: Floats) -> Any:
    if mesh is None:
        return None
    vertices, triangles = client.mesh_arrays(mesh)
    return None if np.array_equal(vertices, organ) else (vertices, triangles)
