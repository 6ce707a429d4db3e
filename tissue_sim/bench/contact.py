"""Benchmark `tissue_sim bench contact`: time of a contact set with two tools in contact, as they press and drag."""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

from tissue_sim.array_types import Floats
from tissue_sim.bench import rows
from tissue_sim.bench.arguments import add_shared
from tissue_sim.bench.pinch_tools import both
from tissue_sim.bench.printing import Bound, Result, aligned, bound_lines, figure, noise_lines
from tissue_sim.bench.timing import in_one_thread, noise_burst
from tissue_sim.contact.finder import ContactQuery
from tissue_sim.contact.scene import Scene
from tissue_sim.contact.tools import Tool
from tissue_sim.json_types import JsonObject
from tissue_sim.model.data.contact_set import ContactSet
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.shipped import shipped_organ

DEPTH, SPEED, DRAWN = 0.004, 0.04, 0.01  # m, m/s, m: how deep, how fast, how far along the surface
MOST = 4e-4  # s, bound of the p99 with two spheres of 5 mm


class Pressed(NamedTuple):
    """Results of two tools: processor time of every set, s, most points in one, and queries to FCL."""

    name: str
    seconds: Floats
    points: int
    asked: int
    sets: int
    force: float  # N, largest


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    add_shared(parser, check=True)


def run(args: argparse.Namespace) -> Result:
    """Measure what the arguments ask for."""
    found = in_one_thread(measure, Organ.load(args.organ or shipped_organ()))
    return Result(found, text(found))


def measure(organ: Organ) -> JsonObject:
    """Return the figures of every pair of tools; meant for a process of one thread."""
    with tempfile.TemporaryDirectory() as folder:
        measured = []
        with rows.until_stopped():
            for name, tools in rows.each(pairs(Path(folder)), "pairs of tools"):
                measured.append(pressed(organ, name, tools))
                rows.report(name, f"p50 {1e6 * float(np.median(measured[-1].seconds)):.0f} us")
    return as_json(measured, noise_burst(2000))


def as_json(measured: Sequence[Pressed], bursts: Floats) -> JsonObject:
    """Return all figures, and the bound on the first pair; bursts: s of a fixed loop, in the same run."""
    loop = float(np.median(bursts))
    found: list[JsonObject] = [
        {
            "tools": one.name,
            "p50_us": 1e6 * float(np.percentile(one.seconds, 50)),
            "p99_us": 1e6 * float(np.percentile(one.seconds, 99)),
            "of_fixed_loop": float(np.percentile(one.seconds, 50)) / loop,
            "points": one.points,
            "sets": one.sets,
            "fcl_asked": one.asked,
            "largest_force_n": one.force,
        }
        for one in measured
    ]
    bound = Bound(f"{measured[0].name}, p99", found[0]["p99_us"], 1e6 * MOST, "us")
    noise = float(np.percentile(bursts, 99)) / loop
    return {"rows": found, "bounds": [bound.as_json()], "fixed_loop_us": 1e6 * loop, "noise": noise}


def pairs(folder: Path) -> list[tuple[str, list[Tool]]]:
    """Return names and tools of what is measured; mesh files are written into a folder."""
    box = trimesh.creation.box((0.006, 0.006, 0.03))
    box.apply_translation([0.0, 0.0, -0.015])
    box.export(folder / "box.stl")
    trimesh.creation.torus(0.01, 0.003).export(folder / "ring.stl")

    return [
        ("two spheres of 5 mm", both(radius=0.005)),
        ("two spheres of 2 mm", both(radius=0.002)),
        ("two capsules of 3 mm", both(shape="capsule", radius=0.003, length=0.04)),
        ("two grippers of 3 mm", both(shape="gripper", radius=0.003, length=0.03)),
        ("two boxes", both(shape="mesh", mesh=str(folder / "box.stl"))),
        ("two rings (not convex)", both(shape="mesh", mesh=str(folder / "ring.stl"))),
    ]


def pressed(organ: Organ, name: str, tools: list[Tool]) -> Pressed:
    """Press both tools into the front and the side of an organ, and drag them along it."""
    scene = Scene(organ, tools, ticks_a_set=4)
    find, seconds, points = scene.finder.find, [], [0]
    scene.finder.warm_up(organ.rest_positions)

    def timed(position: Floats, sought: ContactQuery) -> ContactSet:
        start = time.thread_time()
        found = find(position, sought)
        seconds.append(time.thread_time() - start)
        points[0] = max(points[0], found.header.points)
        return found

    scene.finder.find = timed  # type: ignore[method-assign, assignment]
    surface, force = organ.surface_positions, 0.0
    directions = np.array([[-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    places = [surface[np.argmin(surface @ direction)] - 0.006 * direction for direction in directions]
    turns = [Rotation.align_vectors([direction], [[0.0, 0.0, 1.0]])[0].as_quat() for direction in directions]
    press, draw = round(1e3 * (DEPTH + 0.006) / SPEED), round(1e3 * DRAWN / SPEED)
    for tick in range(press + draw):
        deep = min(tick / press, 1.0) * (DEPTH + 0.006)
        along = max(0, tick - press) / draw * DRAWN
        for tool in range(2):
            scene.move(tool, places[tool] + deep * directions[tool] + [0.0, 0.0, along], turns[tool])
        scene.step()
        force = max(force, float(np.linalg.norm(scene.wrenches[:, :3], axis=1).max()))
    touching = np.array(seconds[press // 8 :])
    return Pressed(name, touching, points[0], scene.finder.counters.narrow_phases, scene.finder.counters.sets, force)


def text(found: JsonObject) -> str:
    """Return the figures as a table."""
    table = [["", "p50 us", "p99 us", "p50 relative to loop", "points", "sets", "FCL queries", "force N"]]
    for row in found["rows"]:
        cells = [figure(row[key]) for key in ("p50_us", "p99_us", "of_fixed_loop", "points", "sets", "fcl_asked")]
        table.append([row["tools"], *cells, f"{row['largest_force_n']:.2f}"])
    lines = [
        "a contact set for every fourth tick of 1 ms; processor time of one thread; a fixed loop takes"
        f" {figure(found['fixed_loop_us'])} us",
        "",
        *aligned(table),
        "",
        *bound_lines(found["bounds"]),
        *noise_lines(found["noise"]),
    ]
    return "\n".join(lines)
