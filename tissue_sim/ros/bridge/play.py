"""`tissue_sim bridge`: a scripted haptic bridge, for demonstrations and for tests."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from tissue_sim.errors import UserError
from tissue_sim.ros.bridge.script import ACTIONS, SCRIPT
from tissue_sim.ros.shared import client

if TYPE_CHECKING:
    from tissue_sim.contact.gripper import Jaws
    from tissue_sim.ros.bridge.motion import Path
    from tissue_sim.ros.bridge.probing import Floats
    from tissue_sim.ros.bridge.scripted_tool import ScriptedTool
    from tissue_sim.ros.shared.tool_link import ToolLink

TOOLS = ("left", "right")  # of a node that tells none
LOOK_AGAIN = 1.0  # s between two looks for another organ, or another bridge
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
        help="names of the tools; a nip takes the first two, a grip the first gripper (default: the node's)",
    )
    parser.add_argument("--node", type=client.node_name, default="tissue_sim", help="name of the node")
    parser.add_argument(
        "--radius",
        type=client.number(1e-4, 0.1, "m"),
        help="of the tools, m: how far from the organ they begin to touch it (default: the node's largest)",
    )
    parser.add_argument(
        "--script",
        type=_script,
        help=f"what to do, in this order, of {','.join(ACTIONS)}; all but the grip unless given",
    )
    parser.add_argument(
        "--wait", type=client.number(0.0, 3600.0, "s"), default=30.0, help="how long to wait for the node, s"
    )


def run(args: argparse.Namespace) -> int:
    """Play the script; returns 0, or 1 when the node's mesh or parameters do not come."""
    if args.script and args.tools:
        _check(args.script, args.tools)

    from shape_msgs.msg import Mesh

    from tissue_sim.ros.bridge.scripted_tool import ScriptedTool
    from tissue_sim.ros.bridge.trajectory import plan
    from tissue_sim.ros.shared.node_parameters import NodeParameters

    with client.Stop() as stop, client.client_node("haptic_bridge", args.node) as node:
        parameters = NodeParameters(args.node)
        meshes = client.Inbox(node, Mesh, f"/{args.node}/mesh", client.latched_qos())
        mesh = _wait_until(meshes.take, args.wait, stop)
        if mesh is None:
            return 0 if stop else _not_there(args, f"no mesh on /{args.node}/mesh")
        values = _wait_until(parameters.poll, args.wait, stop)
        if values is None:
            return 0 if stop else _not_there(args, f"no answer from /{args.node}/get_parameters")
        links, script, jaws, radius = cast(values, args)
        tools = [ScriptedTool(node, link, link.tool.name in jaws) for link in links]
        names = [tool.name for tool in tools]
        vertices, triangles = client.mesh_arrays(mesh)
        _wait_until(lambda: all(tool.heard for tool in tools), MATCHING, stop)
        player = Player(tools, args.rate, args.seconds)
        while True:
            path = plan(vertices, triangles, radius, names, script, jaws)
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


class Cast(NamedTuple):
    """How each tool is spoken to, what they play, the jaws of those that grip, and the radius m that a path is for."""

    links: list[ToolLink]
    script: tuple[str, ...]
    jaws: dict[str, Jaws]
    radius: float


def cast(values: Mapping[str, Any], args: argparse.Namespace) -> Cast:
    """Who plays, by a node's parameters; one that tells none is taken for a node as it is by default.

    Raises UserError when it lacks a tool, or a gripper to grip with.
    """
    from tissue_sim.ros.shared.tool_link import ToolLink

    there = tuple(values.get("tools", ()))
    for name in args.tools or ():
        if there and name not in there:
            raise UserError(f"/{args.node} has no tool '{name}'; it has {', '.join(there)}: choose with --tools")
    links = [
        ToolLink.told(values, name, args.node) or ToolLink.by_default(name, "organ")
        for name in args.tools or there or TOOLS
    ]
    script = args.script or SCRIPT[: len(SCRIPT) if len(links) > 1 else -1]
    jaws: dict[str, Jaws] = {}
    if "grip" in script:
        jaws = {link.tool.name: link.tool.jaws for link in links if link.tool.shape == "gripper"}
        if not jaws:
            shapes = ", ".join(f"'{link.tool.name}' is a {link.tool.shape}" for link in links)
            raise UserError(
                f"a grip needs a gripper; on /{args.node} {shapes}: start it with --params-file config/gripper.yaml"
            )
        if set(script) == {"grip"} and not args.tools:
            links = [link for link in links if link.tool.name in jaws][:1]
    _check(script, [link.tool.name for link in links])
    return Cast(links, script, jaws, args.radius or max(link.tool.radius for link in links))


class Player:
    """Sends a path's poses at absolute deadlines; late ones are left out, so that speeds stay true."""

    def __init__(self, tools: list[ScriptedTool], rate: float, seconds: float | None) -> None:
        self._tools, self._rate = tools, rate
        self._end = None if seconds is None else time.monotonic() + seconds
        self.skipped = 0
        self._told: set[str] = set()  # of which tools it was told that others move them

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
                self._tell_of_rivals()
        start, last = time.monotonic(), max(tick - 1, 0) / self._rate
        leaving = zip(path.retreat(last, self._rate), path.retreat_jaws(last, self._rate), strict=True)
        for step, (poses, opened) in enumerate(leaving):
            self._send(poses, opened, start + step / self._rate)
        return found

    def _tell_of_rivals(self) -> None:
        for tool in self._tools:
            if tool.name not in self._told and tool.rivals() > 0:
                self._told.add(tool.name)
                what = f"{tool.topic} has another publisher: {tool.name} jumps between both"
                sys.stderr.write(f"tissue_sim bridge: {what}\n")

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
