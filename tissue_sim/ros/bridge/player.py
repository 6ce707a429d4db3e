"""The tools of a script, and its playback: a path's poses at absolute deadlines."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from shape_msgs.msg import Mesh

from tissue_sim.array_types import Floats, Longs
from tissue_sim.contact.gripper import Jaws
from tissue_sim.errors import UserError
from tissue_sim.json_types import JsonObject
from tissue_sim.ros.bridge.motion import Path
from tissue_sim.ros.bridge.script import SCRIPT, check
from tissue_sim.ros.bridge.scripted_tool import ScriptedTool
from tissue_sim.ros.shared import client
from tissue_sim.ros.shared.tool_link import ToolLink

TOOLS = ("left", "right")  # of a node that names none
LOOK_AGAIN = 1.0  # s between checks for another organ, or another bridge


# Link of each tool, the script, the jaws of those that grip, and the radius, m, that a path is for.
Cast = tuple[list[ToolLink], tuple[str, ...], dict[str, Jaws], float]


def cast(values: JsonObject, args: argparse.Namespace) -> Cast:
    """Choose the tools and the script by a node's parameters; a node without them counts as one with the defaults.

    Raises UserError when the node lacks a tool, or a gripper to grip with.
    """
    there = tuple(values.get("tools", ()))
    for name in args.tools or ():
        if there and name not in there:
            raise UserError(f"/{args.node} has no tool '{name}'; it has {', '.join(there)}: choose with --tools")
    links = [
        ToolLink.from_parameters(values, name, args.node) or ToolLink.by_default(name, "organ")
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
    check(script, [link.tool.name for link in links])
    return links, script, jaws, args.radius or max(link.tool.radius for link in links)


class Player:
    """Sends a path's poses for so many seconds; late ones are left out, so that speeds stay true.

    relinked: asked before each pose, gives the tools' links again, by their names, where the organ was moved.
    """

    def __init__(
        self,
        tools: Sequence[ScriptedTool],
        seconds: float | None,
        relinked: Callable[[], Mapping[str, ToolLink]] = dict,
    ) -> None:
        self._tools, self._relinked = tools, relinked
        self._end = np.inf if seconds is None else time.monotonic() + seconds
        self.skipped = 0
        self._warned: set[str] = set()  # tools whose other publishers were reported

    def play(
        self, path: Path, stop: client.Stop, meshes: client.NewestMessage, organ: Floats
    ) -> tuple[Floats, Longs] | None:
        """Play a path repeatedly until the time is over, a signal asks for it, or the node has another organ.

        Then the tools leave the tissue.

        meshes: receives the node's mesh; organ (n, 3) m: points of the present organ's surface. Returns the other
        organ's vertices and triangles, or None.
        """
        poses, angles = path.poses, path.angles
        start, next_look, tick, found = time.monotonic(), time.monotonic() + LOOK_AGAIN, 0, None
        while not stop and found is None and (now := time.monotonic()) < self._end:
            due = int((now - start) * path.rate)
            self.skipped += max(0, due - tick)
            tick = max(tick, due)
            self._send(poses[tick % len(poses)], angles[tick % len(poses)], start + tick / path.rate)
            tick += 1
            if now > next_look:
                next_look = now + LOOK_AGAIN
                found = _other_organ(meshes.take(), organ)
                self._warn_of_other_publishers()
        start, leaving = time.monotonic(), path.retreat(max(tick - 1, 0) % len(poses))
        for step, stance in enumerate(zip(leaving.poses, leaving.angles, strict=True)):
            self._send(*stance, start + step / path.rate)
        return found

    def _warn_of_other_publishers(self) -> None:
        for tool in self._tools:
            if tool.name not in self._warned and tool.other_publishers() > 0:
                self._warned.add(tool.name)
                what = f"{tool.topic} has another publisher: {tool.name} jumps between the two"
                sys.stderr.write(f"tissue_sim bridge: {what}\n")

    def _send(self, poses: Floats, angles: Floats, deadline: float) -> None:
        links = self._relinked()
        for tool in self._tools:
            if tool.name in links:
                tool.renew(links[tool.name])
        if (ahead := deadline - time.monotonic()) > 0.0:
            time.sleep(ahead)
        stamp = time.time_ns()
        for tool, angle in zip(self._tools, angles, strict=True):  # first: the node opens the jaws with the next pose
            tool.open(stamp, float(angle))
        for tool, pose in zip(self._tools, poses, strict=True):
            tool.publish(stamp, pose)
        for tool in self._tools:
            tool.receive()


def _other_organ(mesh: Mesh | None, organ: Floats) -> tuple[Floats, Longs] | None:
    if mesh is None:
        return None
    vertices, triangles = client.mesh_arrays(mesh)
    return None if np.array_equal(vertices, organ) else (vertices, triangles)
