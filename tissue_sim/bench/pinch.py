"""`tissue_sim bench pinch`: two tools squeeze the organ, hold and let go; time of a tick, cells inside out, force."""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import trimesh
from scipy.spatial.transform import Rotation
from tqdm import tqdm

from tissue_sim.array_types import Floats
from tissue_sim.bench.arguments import add_shared, check_shared
from tissue_sim.bench.printing import Bound, aligned, bound_lines, emit, exit_code, figure, noise_lines
from tissue_sim.bench.timing import in_one_thread, noise_burst
from tissue_sim.contact.scene import Scene
from tissue_sim.contact.tools import Tool
from tissue_sim.model.cells import swelling
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.shipped import shipped_organ

SHARES = (0.2, 0.4, 0.6)  # of the organ's width, that the tools squeeze it by
CLEAR = 0.006  # m between tool and organ at the start
NEAR = 0.006  # m from the axis, where the organ's width is taken
CLOSING, HOLDING, OPENING, FREE = 800, 400, 300, 3000  # ticks of 1 ms; the last at the most
LOOK = 10  # ticks between two looks at the cells
MOST_TICK, MOST_LEFT = 400.0, 0.1  # us, p99; mm, of what stays of the shape


class Pinch(NamedTuple):
    """One pair of tools, squeezing along one axis."""

    tools: str
    axis: int
    share: float
    width: float  # m
    seconds: Floats  # of processor time of every tick in touch
    substeps: int  # the most
    most_turned: int  # cells inside out, at the worst
    held_turned: int  # when the tools have stood still
    least: float  # J of a cell then
    left_turned: int  # long after
    left: float  # m from rest then
    faults: int
    force: float  # N on the tools in the mean, held


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    add_shared(parser, check=True)


def run(args: argparse.Namespace) -> int:
    """Measure and print; returns 0, or with --check 1 when a bound is missed."""
    check_shared(args)
    found = as_json(*in_one_thread(measure, Organ.load(args.organ or shipped_organ())))
    emit(found, text(found), args.json)
    return exit_code(found, check=args.check)


def measure(organ: Organ) -> tuple[list[Pinch], Floats]:
    """Every pair of tools on every axis by every share; and seconds of a fixed loop. For a process of one thread."""
    with tempfile.TemporaryDirectory() as folder:
        todo = [(*pair, axis, share) for pair in pairs(Path(folder)) for axis in range(3) for share in SHARES]
        return [pinched(organ, *one) for one in tqdm(todo, disable=None, desc="pinch")], noise_burst(2000)


def pairs(folder: Path) -> list[tuple[str, list[Tool]]]:
    """Names and tools; a mesh file goes into a folder."""
    jaw = trimesh.creation.box((0.012, 0.012, 0.004))
    jaw.apply_translation([0.0, 0.0, -0.002])
    jaw.export(folder / "jaw.stl")

    def both(**given: Any) -> list[Tool]:
        return [Tool("left", **given), Tool("right", **given)]

    return [
        ("spheres of 5 mm", both(radius=0.005)),
        ("grippers", both(shape="gripper", radius=0.003, length=0.03)),
        ("flat jaws", both(shape="mesh", mesh=str(folder / "jaw.stl"))),
    ]


def pinched(organ: Organ, name: str, tools: list[Tool], axis: int, share: float) -> Pinch:
    """Squeeze the organ's middle along an axis by a share of its width there, hold, let go, and wait."""
    scene = Scene(organ, tools, ticks_a_set=4)
    scene.finder.warm_up(organ.rest_positions)
    simulation = scene.simulation
    step, seconds = simulation.step, []

    def timed() -> None:
        start = time.thread_time()
        step()
        seconds.append(time.thread_time() - start)

    simulation.step = timed  # type: ignore[method-assign]
    surface = organ.surface_positions
    middle = surface.mean(axis=0)
    beside = np.linalg.norm(np.delete(surface - middle, axis, axis=1), axis=1)
    low, high = np.min(surface[beside < NEAR, axis]), np.max(surface[beside < NEAR, axis])
    ahead = tools[0].radius if tools[0].shape == "sphere" else 0.0
    ways = np.eye(3)[axis] * np.array([[1.0], [-1.0]])
    turns = [Rotation.align_vectors([way], [[0.0, 0.0, 1.0]])[0].as_quat() for way in ways]
    start = np.tile(middle, (2, 1))
    start[:, axis] = low, high
    start -= ahead * ways
    depth, substeps, turned = 0.5 * share * (high - low), 0, 0

    def go(deep: float) -> None:
        nonlocal substeps, turned
        for tool in range(2):
            scene.move(tool, start[tool] + deep * ways[tool], turns[tool])
        scene.step()
        substeps = max(substeps, simulation.state.status.substeps)
        if simulation.state.status.tick % LOOK == 0:
            turned = max(turned, int(np.count_nonzero(swelling(simulation.model, simulation.positions) <= 0.0)))

    for tick in range(CLOSING):
        go(-CLEAR + (depth + CLEAR) * (tick + 1) / CLOSING)
    for _ in range(HOLDING):
        go(depth)
    held = swelling(simulation.model, simulation.positions)
    force = float(np.linalg.norm(scene.wrenches[:, :3], axis=1).mean())
    for tick in range(OPENING):
        go(depth - (depth + CLEAR) * (tick + 1) / OPENING)
    touching = np.array(seconds)
    for _ in range(FREE):
        scene.step()
        if simulation.asleep:
            break
    return Pinch(
        tools=name,
        axis=axis,
        share=share,
        width=float(high - low),
        seconds=touching,
        substeps=substeps,
        most_turned=turned,
        held_turned=int(np.count_nonzero(held <= 0.0)),
        least=float(held.min()),
        left_turned=int(np.count_nonzero(swelling(simulation.model, simulation.positions) <= 0.0)),
        left=float(np.linalg.norm(simulation.positions - organ.rest_positions, axis=1).max()),
        faults=int(simulation.state.count.faults),
        force=force,
    )


def as_json(pinches: Sequence[Pinch], bursts: Floats) -> dict[str, Any]:
    """All figures and bounds; bursts: s of a fixed loop, in the same run."""
    rows: list[dict[str, Any]] = [
        {
            "tools": one.tools,
            "axis": "xyz"[one.axis],
            "share_percent": 100.0 * one.share,
            "width_mm": 1e3 * one.width,
            "p50_us": 1e6 * float(np.percentile(one.seconds, 50)),
            "p99_us": 1e6 * float(np.percentile(one.seconds, 99)),
            "most_substeps": one.substeps,
            "most_turned": one.most_turned,
            "held_turned": one.held_turned,
            "least_volume": one.least,
            "left_turned": one.left_turned,
            "left_mm": 1e3 * one.left,
            "faults": one.faults,
            "force_n": one.force,
        }
        for one in pinches
    ]
    gentle = [row for row in rows if row["share_percent"] < 50.0]
    bounds = [
        Bound("cells inside out, held at 20 and 40 %", max(row["held_turned"] for row in gentle), 0.0, "cells"),
        Bound("cells inside out long after", max(row["left_turned"] for row in rows), 0.0, "cells"),
        Bound("what stays of the shape", max(row["left_mm"] for row in rows), MOST_LEFT, "mm"),
        Bound("tick, p99 of the worst", max(row["p99_us"] for row in rows), MOST_TICK, "us"),
    ]
    loop = float(np.median(bursts))
    noise = float(np.percentile(bursts, 99)) / loop
    return {"rows": rows, "bounds": [bound.as_json() for bound in bounds], "fixed_loop_us": 1e6 * loop, "noise": noise}


def text(found: dict[str, Any]) -> str:
    """The figures as a table."""
    names = ["tools", "axis", "%", "tick p50", "p99 us", "substeps", "turned", "held", "least J", "after", "faults"]
    table = [[*names, "force N"]]
    for row in found["rows"]:
        numbers = [figure(row[key]) for key in ("share_percent", "p50_us", "p99_us")]
        counts = [str(row[key]) for key in ("most_substeps", "most_turned", "held_turned")]
        ends = [f"{row['least_volume']:.2f}", str(row["left_turned"]), str(row["faults"]), f"{row['force_n']:.2f}"]
        table.append([row["tools"], row["axis"], *numbers, *counts, *ends])
    lines = [
        "squeezed by a share of the width in 0.8 s, held for 0.4 s, let go in 0.3 s; processor time of one thread",
        f"a fixed loop beside it takes {figure(found['fixed_loop_us'])} us",
        "",
        *aligned(table, 2),
        "",
        *bound_lines(found["bounds"]),
        *noise_lines(found["noise"]),
    ]
    return "\n".join(lines)
