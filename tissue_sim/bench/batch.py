"""Benchmark `tissue_sim bench batch`: environment steps a second of many copies, each pressed by a ball.

An environment step is 20 ms of simulated time. MuJoCo's flex does the same presses of the same surface beside it.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np

from tissue_sim.array_types import Floats
from tissue_sim.bench import rows
from tissue_sim.bench.arguments import add_shared
from tissue_sim.bench.pressed_flex import PressedFlex
from tissue_sim.bench.printing import Bound, Result, aligned, bound_lines
from tissue_sim.contact.scene import Scene
from tissue_sim.contact.scene_batch import SceneBatch
from tissue_sim.contact.tools import Tool
from tissue_sim.errors import UserError
from tissue_sim.json_types import JsonObject
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.shipped import shipped_organ

STEP = 0.02  # s of an environment step
RADIUS = 0.008  # m of the ball
DEPTH, CLEAR = 0.005, 0.001  # m, how deep it goes, and how far out
PERIOD = 50  # environment steps of a press, in and out
WARM = 10  # steps before anything is timed
LEAST_FORCE = 0.02  # N, that every copy feels at some time of its press
LEAST_RATE, FEW_CELLS, LEAST_RATE_FEW = 500.0, 5000, 1500.0  # steps a second and core; of an organ of so few cells
IDLE = 0.93  # of the cores that a measurement must have had for two threads to be compared with one
MOST_MEMORY, LEAST_SPEEDUP = 2.0, 1.9  # MB a copy; two threads over one
PAPER_CORES = 64
PEERS = (("MuJoCo flex, steps of 1 ms", 0.001), ("MuJoCo flex, one step of 20 ms", STEP))


class Measured(NamedTuple):
    """Measured rates of a number of threads."""

    name: str
    threads: int
    steps_a_second: float  # of the wall clock
    steps_a_core_second: float  # of the processor's time, which other programs don't shorten
    cores: float  # processor time over that of the clock
    highest_force: Floats  # (n,) N of each copy


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    add_shared(parser, seconds=10.0, check=True)
    parser.add_argument("--copies", type=int, default=32, help="number of copies")
    parser.add_argument("--no-peers", action="store_true", help="leave MuJoCo out")


def run(args: argparse.Namespace) -> Result:
    """Measure what the arguments ask for."""
    if not 2 <= args.copies <= 10_000:
        raise UserError(f"--copies {args.copies} is outside 2..10000")
    organ = Organ.load(args.organ or shipped_organ())
    presses = presses_on(organ, args.copies)
    scene = pressed_scene(organ)
    measured, peers = [], []
    with rows.until_stopped():
        for threads in rows.each(sorted({1, 2, len(os.sched_getaffinity(0))}), "batches"):
            batch = SceneBatch(scene, args.copies, threads=threads)
            measured.append(of_batch(batch, presses, args.seconds))
            rows.report(measured[-1].name, f"{measured[-1].steps_a_second:.0f} steps/s")
        for name, step in rows.each([] if args.no_peers else PEERS, "MuJoCo"):
            peers.append(of_flex(name, step, presses, args.seconds))
            rows.report(name, f"{peers[-1].steps_a_second:.1f} steps/s")
    found = as_json(organ, measured, peers, batch.bytes_a_copy, differing(scene, presses))
    return Result(found, text(found))


class Presses(NamedTuple):
    """Places that the ball of each copy presses."""

    organ: Organ
    place: Floats  # (n, 3) m, on the surface
    outward: Floats  # (n, 3)
    phase: Floats  # (n,) steps by which each begins earlier

    def at(self, step: int) -> Floats:
        """Return where the balls are, (n, 3) m."""
        depth = (DEPTH + CLEAR) * np.sin(np.pi * (step + self.phase) / PERIOD) ** 2 - CLEAR
        return self.place + (RADIUS - depth)[:, None] * self.outward


def presses_on(organ: Organ, count: int) -> Presses:
    """Return presses spread over the half of the surface that is farthest from what is fixed."""
    surface = organ.surface_positions
    held = surface[organ.fixed[organ.fixed < organ.n_surface]] if len(organ.fixed) else surface.mean(axis=0)[None]
    apart = np.linalg.norm(surface[:, None] - held[None], axis=2).min(axis=1)
    nodes = np.argsort(-apart, kind="stable")[: organ.n_surface // 2]
    nodes = nodes[np.linspace(0, len(nodes) - 1, count).astype(np.int64)]
    return Presses(organ, surface[nodes], organ.surface_normals[nodes], np.linspace(0.0, PERIOD, count))


def pressed_scene(organ: Organ) -> Scene:
    """Return an organ and a ball, whose contacts are searched once in an environment step."""
    return Scene(organ, [Tool("ball", radius=RADIUS)], ticks_a_set=20)


def of_batch(batch: SceneBatch, presses: Presses, seconds: float) -> Measured:
    """Return what a batch does in about so many seconds."""
    count, ticks = len(batch), round(STEP * batch.rate)
    poses = np.zeros((count, 1, 7))
    poses[..., 6] = 1.0

    def step(number: int) -> None:
        poses[:, 0, :3] = presses.at(number)
        batch.move(poses)
        batch.step(ticks)

    name = f"{batch.threads} thread{'s' if batch.threads > 1 else ''}"

    def forces() -> Floats:
        return np.asarray(np.linalg.norm(batch.wrenches[:, 0, :3], axis=1))

    return _timed(Timed(name, batch.threads, step, forces), seconds, PERIOD)


def of_flex(name: str, step: float, presses: Presses, seconds: float) -> Measured:
    """Return what MuJoCo does in about so many seconds, on all cores: two copies for each."""
    threads = len(os.sched_getaffinity(0))
    count = min(2 * threads, len(presses.place))
    flex = PressedFlex(presses.organ, RADIUS, step, count)
    parts = np.array_split(np.arange(count), threads)
    with ThreadPoolExecutor(threads) as pool:

        def advance(number: int) -> None:
            places = presses.at(number)
            list(pool.map(lambda part: flex.step(part.tolist(), places, round(STEP / step)), parts))

        return _timed(Timed(name, threads, advance, lambda: flex.forces), seconds, 1)


class Timed(NamedTuple):
    """Timed work: steps of all copies, by their number, and the forces after one."""

    name: str
    threads: int
    step: Callable[[int], None]
    forces: Callable[[], Floats]


def _timed(timed: Timed, seconds: float, least: int) -> Measured:
    """Return the steps of a second, timed for so long, and for `least` steps at least; and the largest forces."""
    timed.step(0)
    highest = timed.forces()
    for number in range(1, min(WARM, least)):
        timed.step(number)
    done, wall, used = 0, 0.0, 0.0
    while wall < seconds or done < least:
        start, start_used = time.perf_counter(), time.process_time()
        timed.step(WARM + done)
        wall, used = wall + time.perf_counter() - start, used + time.process_time() - start_used
        highest = np.maximum(highest, timed.forces())
        done += 1
    rows.keep()
    copies = len(highest)
    return Measured(timed.name, timed.threads, done * copies / wall, done * copies / used, used / wall, highest)


def differing(scene: Scene, presses: Presses, steps: int = 30) -> int:
    """Return how many numbers of two copies' forces and surfaces differ from those of the scene that does the same."""
    batch = SceneBatch(scene, 2)
    poses = np.zeros((2, 1, 7))
    poses[..., 6] = 1.0
    for number in range(steps):
        poses[:, 0, :3] = presses.at(number)[:1]
        batch.move(poses)
        batch.step(20)
    for number in range(steps):
        scene.move(0, presses.at(number)[0])
        scene.step(20)
    same = batch.wrenches[:, 0] == scene.wrench(0), batch.surface_positions() == scene.surface_positions()
    return int(sum(np.count_nonzero(~one) for one in same))


def as_json(organ: Organ, measured: list[Measured], peers: list[Measured], size: int, different: int) -> JsonObject:
    """Return the figures, and their bounds."""
    one = measured[0]
    # While other programs take the cores, a ratio of times says nothing about this one.
    is_busy = any(row.cores < IDLE * row.threads for row in measured[:2])
    speedup = None if is_busy or len(measured) < 2 else measured[1].steps_a_second / one.steps_a_second
    serial = None if speedup is None else min(max(2.0 / speedup - 1.0, 0.0), 1.0)
    few = len(organ.cell_nodes) < FEW_CELLS
    pressing = 100.0 * float(np.mean(one.highest_force > LEAST_FORCE))
    bounds = [
        Bound("environment steps a second and core", one.steps_a_core_second, _least(few), "1/s", True),
        Bound("two threads over one", speedup, LEAST_SPEEDUP, "times", True),
        Bound("memory of a copy", 1e-6 * size, MOST_MEMORY, "MB"),
        Bound(f"copies pressed with {LEAST_FORCE:g} N or more", pressing, 100.0, "%", True),
        Bound("numbers that differ from those of the scene alone", different, 0.0, "numbers"),
    ]
    return {
        "organ": organ.name,
        "cells": len(organ.cell_nodes),
        "copies": len(one.highest_force),
        "rows": [row._asdict() | {"highest_force": float(np.median(row.highest_force))} for row in measured + peers],
        "megabytes_a_copy": 1e-6 * size,
        "speedup_of_two": speedup,
        "serial_fraction": serial,
        "computed_for_64_cores": None if serial is None else one.steps_a_core_second * _amdahl(serial, PAPER_CORES),
        "bounds": [bound.as_json() for bound in bounds],
    }


def _least(few: bool) -> float:
    return LEAST_RATE_FEW if few else LEAST_RATE


def _amdahl(serial: float, cores: int) -> float:
    """Return how much faster that many cores are where a fraction of the work can't be shared."""
    return 1.0 / (serial + (1.0 - serial) / cores)


def text(found: JsonObject) -> str:
    """Return the figures as a table."""
    head = ["", "threads", "steps/s", "steps/s and core", "force N, median of the highest"]
    table = [head] + [
        [
            one["name"],
            str(one["threads"]),
            f"{one['steps_a_second']:.4g}",
            f"{one['steps_a_core_second']:.4g}",
            f"{one['highest_force']:.2f}",
        ]
        for one in found["rows"]
    ]
    lines = [
        f"organ '{found['organ']}', {found['cells']} cells, {found['copies']} copies, each pressed by a ball;"
        f" a step is {1e3 * STEP:g} ms",
        *aligned(table),
        f"a second and core counts the processor's time; a copy takes {found['megabytes_a_copy']:.2f} MB",
    ]
    if found["computed_for_64_cores"] is None:
        lines.append("other programs took the cores: two threads were not compared with one")
    else:
        lines.append(
            f"computed, not measured: {found['computed_for_64_cores']:.0f} steps/s on {PAPER_CORES} such cores, with"
            f" {100.0 * found['serial_fraction']:.1f} % of the work not shared, as two threads show (Amdahl)"
        )
    return "\n".join([*lines, "", *bound_lines(found["bounds"])])
