"""Command `tissue_sim drive`: a learned policy moves a tool of a running node, as a bridge would."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

import numpy as np

from tissue_sim import progress
from tissue_sim.array_types import Floats, Longs
from tissue_sim.errors import UserError
from tissue_sim.json_types import JsonObject
from tissue_sim.ros.bridge.served import served_by, write_missing
from tissue_sim.ros.shared import client

if TYPE_CHECKING:
    from tissue_sim.environments.blade_path import MadeCut
    from tissue_sim.environments.policies import Learned
    from tissue_sim.environments.tasks import Task
    from tissue_sim.ros.bridge.cutter import Cutter
    from tissue_sim.ros.bridge.driven_tool import Done, Goal
    from tissue_sim.ros.shared.tool_link import ToolLink


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    add = parser.add_argument
    add("policy", metavar="POLICY", help="file that `tissue_sim learn` has written, or a task whose policy ships")
    add("--node", type=client.node_name, default="tissue_sim", help="name of the node")
    add("--tool", metavar="NAME", help="its tool (default: the first one)")
    add("--organ", metavar="NAME", help="organ of a scene (default: the first one)")
    add(
        "--place",
        type=float,
        nargs=3,
        metavar=("X", "Y", "Z"),
        help="point in the organ's frame, m, to which the surface point of the goal is nearest (default: the middle of"
        " the front; of Retract the lower pole)",
    )
    add("--force", type=client.number(0.01, 20.0, "N"), default=0.3, help="wanted force, N")
    add("--depth", type=client.number(0.002, 0.02, "m"), default=0.01, help="wanted depth of Cut, m")
    add("--length", type=client.number(0.008, 0.1, "m"), default=0.02, help="length of the line of Cut, m")
    add(
        "--along",
        type=float,
        nargs=3,
        metavar=("X", "Y", "Z"),
        help="direction of the line of Cut in the organ's frame (default: the organ's longest axis)",
    )
    add("--seconds", type=client.number(0.1, 3600.0, "s"), help="longest time (default: that of the task's episodes)")
    add("--wait", type=client.number(0.0, 3600.0, "s"), default=30.0, help="longest wait for the node, s")


def run(args: argparse.Namespace) -> int:
    """Drive; return 0, or 1 where the goal isn't met or the node doesn't answer."""
    for name in ("place", "along"):
        if getattr(args, name) is not None and not np.isfinite(getattr(args, name)).all():
            raise UserError(f"--{name} has numbers that are not finite")
    try:
        from tissue_sim.environments.policies import Learned
        from tissue_sim.environments.registration import NAMES
        from tissue_sim.environments.tasks import STEP, task_of
    except ImportError as error:
        raise UserError(f"policies need {error.name}: pip install 'tissue_sim[learn]'") from None
    learned = Learned.load(args.policy)
    task = task_of(learned.task)

    from tissue_sim.organ.normals import surface_normals
    from tissue_sim.ros.bridge.cutter import Cutter
    from tissue_sim.ros.bridge.driven_tool import CLEAR, DrivenTool
    from tissue_sim.ros.shared.node_parameters import NodeParameters

    with client.Stop() as stop, client.client_node("drive", args.node) as node:
        parameters = NodeParameters(node, args.node)
        served = served_by(node, args, parameters, stop)
        if served is None:
            return 0 if stop else 1
        link = link_of(served.values, args, task)
        vertices, triangles = client.mesh_arrays(served.mesh)
        goal = goal_of(vertices, triangles, args, task)
        normals = surface_normals(vertices, triangles.astype(np.int32))
        radius = 0.0 if task.has_jaws else task.tool().radius
        start = goal.place + (radius + CLEAR) * goal.outward
        tool = DrivenTool(node, args.node, link, served.prefix, (vertices, normals))
        cutter = Cutter(node, args.node, served.prefix, args.wait, stop) if task.has_blade else None
        with progress.task(f"waiting for wrenches of '{link.tool.name}'"):
            is_there = tool.meet(start, goal, args.wait, stop)
        if not is_there:
            write_missing(args, f"wrench on /{args.node}/{link.tool.name}/wrench", stop)
            return 0 if stop else 1
        progress.report_by(None)  # nothing of it runs beside the poses
        steps = NAMES[learned.task] if args.seconds is None else round(args.seconds / STEP)
        done = tool.drive(learned, goal, start, steps, stop)
        tool.leave(done.tip, goal)
        made = None
        if cutter is not None and not stop:
            made = made_cut(cutter, done, goal, served.values["frame_id"])
    print(result_line(learned, goal, done, STEP) if cutter is None else cut_line(done, made, STEP))
    is_met = done.is_met if cutter is None else made is not None and made.is_good
    return 0 if is_met or bool(stop) else 1


def made_cut(cutter: Cutter, done: Done, goal: Goal, frame_id: str) -> MadeCut | None:
    """Cut along the path of a blade, as the environment does; None where there is no such cut, or it is refused."""
    path = done.path
    if path is None or not done.is_met or (planned := path.planned()) is None:
        return None
    with progress.task("cutting along the blade's path"):
        depth = cutter.cut(planned.polyline, -goal.outward, planned.depth, frame_id)
    return path.judge(planned, depth)


def cut_line(done: Done, made: MadeCut | None, step: float) -> str:
    """Return the line about a cut."""
    after = f"after {step * done.steps:.2f} s; {done.late} of {done.steps} steps late"
    peak = 0.0 if done.path is None else done.path.peak
    if made is None:
        reason = "the blade's path through the tissue was too short" if done.is_met else "not finished"
        return f"Cut: goal not met: {reason}, at most {peak:.3f} N, {after}"
    return (
        f"Cut: goal {'' if made.is_good else 'not '}met: {1e3 * made.beside:.2f} mm beside the line,"
        f" {100.0 * made.off:.1f} % beside the depth, at most {peak:.3f} N, {after}"
    )


def result_line(learned: Learned, goal: Goal, done: Done, step: float) -> str:
    """Return the line about what an agent did."""
    x, y, z = 1e3 * done.tip
    after = (
        f"after {step * done.steps:.2f} s, tool at {x:.1f}, {y:.1f}, {z:.1f} mm; {done.late} of {done.steps} steps late"
    )
    if learned.task == "Palpate":
        return f"Palpate: {'says that it is here' if done.is_met else 'found nothing'} {after}"
    offset = done.tip - goal.place
    beside = 1e3 * float(np.linalg.norm(offset - (offset @ goal.outward) * goal.outward))
    force = float(done.force @ goal.outward)
    wanted = "" if learned.task == "Retract" else f" of {goal.wanted:.3f} N"
    fraction = f" in {100.0 * done.fraction:.0f} % of the steps" if learned.task == "Hold" else ""
    met = f"goal {'' if done.is_met else 'not '}met{fraction}"
    return f"{learned.task}: {met}: {force:.3f} N{wanted}, {beside:.1f} mm beside the place, {after}"


def link_of(values: JsonObject, args: argparse.Namespace, task: Task) -> ToolLink:
    """Return the link of the tool that is chosen. Raises UserError where the node has none, or another than learned."""
    from tissue_sim.ros.bridge.driven_tool import check_tool
    from tissue_sim.ros.shared.tool_link import ToolLink

    there = tuple(values.get("tools", ()))
    name = args.tool or (there[0] if there else "")
    link = ToolLink.from_parameters(values, name, args.node)
    if link is None:
        raise UserError(f"/{args.node} has no tool '{name}'; it has {', '.join(there) or 'none'}: choose with --tool")
    check_tool(task, link.tool, args.node)
    return link


def goal_of(vertices: Floats, triangles: Longs, args: argparse.Namespace, task: Task) -> Goal:
    """Return the goal at the surface point nearest to the place that is chosen, or a grasp from its side."""
    from tissue_sim.contact.grasp import lower_pole
    from tissue_sim.environments.tasks import Retract
    from tissue_sim.organ.normals import surface_normals
    from tissue_sim.ros.bridge.contact_locations import FRONT, Surface
    from tissue_sim.ros.bridge.driven_tool import Goal

    if args.place is None:
        middle = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
        touch = Surface(vertices, triangles, 1e-3).touch(middle, FRONT)
        place = middle if touch is None else touch.place
    else:
        place = np.array(args.place)
    node = int(np.argmin(np.linalg.norm(vertices - place, axis=1)))
    outward = surface_normals(vertices, triangles)[node]
    if task.has_blade:
        along = lower_pole(vertices)[0] if args.along is None else np.array(args.along)
        along = along - (along @ outward) * outward
        if (size := float(np.linalg.norm(along))) < 1e-6:
            raise UserError("--along points out of the organ at the place; name a direction along its surface")
        half = 0.5 * args.length / size * along
        return Goal(node, vertices[node], vertices[node], outward, args.depth, half=half)
    if not isinstance(task, Retract):
        return Goal(node, vertices[node], vertices[node], outward, args.force)
    grasp = task.grasp(vertices, triangles, lower_pole(vertices)[0] if args.place is None else outward)
    place = grasp.place + grasp.depth * grasp.out
    node = int(np.argmin(np.linalg.norm(vertices - place, axis=1)))
    return Goal(node, vertices[node], place, grasp.out, grasp.width, grasp.turn, grasp.opened)
