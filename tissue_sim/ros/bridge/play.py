"""Command `tissue_sim bridge`: a scripted haptic bridge, for demonstrations and for tests."""

from __future__ import annotations

import argparse

from tissue_sim import progress
from tissue_sim.array_types import Floats, Longs
from tissue_sim.ros.bridge.script import ACTIONS, check
from tissue_sim.ros.bridge.served import served_by
from tissue_sim.ros.shared import client

MATCHING = 3.0  # s, at most, for DDS to bring the tools' topics together


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("--rate", type=client.number(1.0, 2000.0, "Hz"), default=500.0, help="poses per second, Hz")
    parser.add_argument(
        "--seconds", type=client.number(0.01, 1e9, "s"), help="end after this time; without it, run until Ctrl-C"
    )
    parser.add_argument(
        "--tools",
        type=client.names,
        help="names of the tools; nip uses the first two, grip the first gripper (default: the node's)",
    )
    parser.add_argument("--node", type=client.node_name, default="tissue_sim", help="name of the node")
    parser.add_argument(
        "--radius",
        type=client.number(1e-4, 0.1, "m"),
        help="radius of the tools, m, at which they begin to touch the organ (default: the node's largest)",
    )
    parser.add_argument("--organ", metavar="NAME", help="organ of a scene (default: the first one)")
    parser.add_argument(
        "--script",
        type=lambda text: tuple(word.strip() for word in text.split(",")),
        help=f"actions in this order, of {','.join(ACTIONS)} (default: all but grip)",
    )
    parser.add_argument(
        "--wait", type=client.number(0.0, 3600.0, "s"), default=30.0, help="longest wait for the node, s"
    )


def run(args: argparse.Namespace) -> int:
    """Play the script; return 0, or 1 when the node's mesh or parameters do not come."""
    if args.script:
        check(args.script, args.tools)

    from tissue_sim.ros.bridge.contact_locations import Surface
    from tissue_sim.ros.bridge.player import Player, cast
    from tissue_sim.ros.bridge.registration import Registration
    from tissue_sim.ros.bridge.scripted_tool import ScriptedTool
    from tissue_sim.ros.bridge.trajectory import plan
    from tissue_sim.ros.shared.node_parameters import NodeParameters
    from tissue_sim.ros.shared.tool_link import ToolLink

    with client.Stop() as stop, client.client_node("haptic_bridge", args.node) as node:
        parameters = NodeParameters(node, args.node)
        served = served_by(node, args, parameters, stop)
        if served is None:
            return 0 if stop else 1
        links, script, jaws, radius = cast(served.values, args)
        tools = [ScriptedTool(node, link, link.tool.name in jaws) for link in links]
        organ: tuple[Floats, Longs] | None = client.mesh_arrays(served.mesh)
        client.wait_until(lambda: all(tool.has_subscribers for tool in tools), MATCHING, stop)
        registration = Registration(node, args.node, parameters)

        def relinked() -> dict[str, ToolLink]:
            changed = registration.poll() or {}
            found = {link.tool.name: ToolLink.from_parameters(changed, link.tool.name, args.node) for link in links}
            return {name: link for name, link in found.items() if link is not None}

        player = Player(tools, args.seconds, relinked)
        while organ is not None:
            vertices, triangles = organ
            surface = Surface(vertices, triangles, radius)
            path = plan(surface, [tool.name for tool in tools], script, jaws, args.rate)
            print(
                f"organ of {len(vertices)} nodes: {', '.join(script)} in {path.duration:.1f} s, repeatedly, at"
                f" {args.rate:g} Hz",
                flush=True,
            )
            progress.report_by(None)  # nothing of it runs beside the poses
            organ = player.play(path, stop, served.meshes, vertices)
            if organ is not None:
                print("the node has another organ", flush=True)
        peaks = ", ".join(f"{tool.name} {tool.peak:.2f} N" for tool in tools)
        sent, received = sum(tool.sent for tool in tools), sum(tool.received for tool in tools)
        late = f", {player.skipped} skipped" if player.skipped else ""
        print(f"{sent} poses sent{late}, {received} wrenches received, peak force: {peaks}", flush=True)
    return 0
