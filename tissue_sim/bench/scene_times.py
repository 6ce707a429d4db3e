"""`tissue_sim bench scene`: what organs cost that lie beside each other, asleep, poked, and all at once.

Everything that is compared is measured in one run, in turns, in one process with one thread.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numba
import numpy as np

from tissue_sim import progress
from tissue_sim.array_types import Floats
from tissue_sim.bench.arguments import add_shared, check_shared
from tissue_sim.bench.organs import PATCH_NODES, patch_load
from tissue_sim.bench.printing import Bound, bound_lines, emit, exit_code, figure, noise_lines, with_remarks
from tissue_sim.bench.tick_rows import FORCE
from tissue_sim.bench.timing import (
    Phase,
    Ticks,
    Timing,
    clock_cost,
    in_one_thread,
    interleave,
    noise_burst,
    now,
    swelling,
)
from tissue_sim.contact.scene_file import SceneFile
from tissue_sim.model.breathing import Breath
from tissue_sim.model.inputs import load_nodes
from tissue_sim.model.links import make_links
from tissue_sim.model.pairs import make_pairs
from tissue_sim.model.simulation import Simulation
from tissue_sim.model.together import Joined, tick_together
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.placing import placed
from tissue_sim.organ.shipped import shipped_organ

ORGANS = 4
APART = 0.2  # m, so that none touches another
SECONDS, QUICK_SECONDS = 2.0, 0.3  # that each row is measured for
TICK = 1e-3  # s of simulated time

ALONE, BESIDE, ASLEEP, AWAKE = "one organ, poked", "two, one poked", "all asleep", "all poked"
SCENE = "the scene, all poked"
NOISE = "noise"


class Row(NamedTuple):
    """What was timed, of how many organs."""

    name: str
    organs: int
    timing: Timing


class Figures(NamedTuple):
    """What the measuring process hands back."""

    rows: list[Row]
    noise: float  # p99 over median of a fixed loop


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    add_shared(parser, check=True)
    parser.add_argument("--scene", metavar="FILE", help="time the organs of this scene (.yaml), too")
    parser.add_argument("--quick", action="store_true", help="fewer samples")


def run(args: argparse.Namespace) -> int:
    """Measure and print the table; returns 0, or with --check 1 when a bound is missed."""
    check_shared(args)
    organ = Organ.load(Path(args.organ) if args.organ else shipped_organ())
    scene = SceneFile.read(Path(args.scene)) if args.scene else None
    measured = in_one_thread(measure, organ, scene, QUICK_SECONDS if args.quick else SECONDS)
    found = as_json(organ, scene, measured)
    emit(found, text(found), args.json)
    return exit_code(found, check=args.check)


# measuring -----------------------------------------------------------------------------------------


def measure(organ: Organ, scene: SceneFile | None, seconds: float) -> Figures:
    """Time every row; meant for a process of one thread."""
    with progress.task("preparing"):
        bursts: dict[str, Any] = {
            ALONE: Ticks(Simulation(organ), *patch_load(organ, FORCE)),
            BESIDE: JoinedTicks(apart(organ, 2), poked=1),
            ASLEEP: JoinedTicks(apart(organ, ORGANS), poked=0),
            AWAKE: JoinedTicks(apart(organ, ORGANS), poked=ORGANS),
        }
    organs = {ALONE: 1, BESIDE: 2, ASLEEP: ORGANS, AWAKE: ORGANS}
    if scene is not None:
        joined = scene.scene([]).joined
        bursts[SCENE] = Ticks(*_alone(scene)) if joined is None else JoinedTicks(joined, poked=len(scene.organs))
        organs[SCENE] = len(scene.organs)
    timings = interleave(Phase(bursts | {NOISE: noise_burst}, seconds, "scene"))
    noise = timings.pop(NOISE)
    return Figures([Row(name, organs[name], timing) for name, timing in timings.items()], noise.p99 / noise.median)


def _alone(scene: SceneFile) -> tuple[Any, ...]:
    return Simulation(scene.organs[0]), *patch_load(scene.organs[0], FORCE)


def apart(organ: Organ, count: int) -> Joined:
    """So many of an organ in a row, that nothing joins."""
    simulations = [Simulation(placed(organ, (APART * place, 0.0, 0.0))) for place in range(count)]
    return Joined(simulations, make_links(0), make_pairs(), Breath.new())


class JoinedTicks:
    """Bursts of ticks of organs that are advanced together, of which the first `poked` are, as in Ticks."""

    def __init__(self, joined: Joined, poked: int) -> None:
        self.joined = joined
        none = np.zeros(0, dtype=np.int64), np.zeros((0, 3))
        loads = [
            patch_load(one.organ, FORCE) if place < poked else none for place, one in enumerate(joined.simulations)
        ]
        self._loads = tuple((nodes, np.ascontiguousarray(forces)) for nodes, forces in loads)
        self._phase, self._clock = np.zeros(1, dtype=np.int64), np.zeros(2, dtype=np.int64)

    def __call__(self, count: int) -> Floats:
        """Seconds (count,) of count ticks; two more before them warm the caches and don't count."""
        times = np.zeros(count + 2, dtype=np.int64)
        _time_joined(self.joined.worlds, self.joined.handle, self._loads, self._phase, self._clock, times)
        return np.maximum(1e-9 * times[2:] - clock_cost(), 0.0)


@numba.njit(nogil=True, error_model="numpy")
def _time_joined(worlds: Any, joined: Any, loads: Any, phase: Any, clock: Any, times: Any) -> None:
    """Step len(times) ticks and write the ns that each took, in a compiled loop as in the node."""
    for index in range(len(times)):
        share = swelling(phase)
        for organ in range(len(worlds)):
            nodes, forces = loads[organ]
            if len(nodes) > 0:
                load_nodes(worlds[organ].state, nodes, share * forces)
        start = now(clock)
        tick_together(worlds, joined)
        times[index] = now(clock) - start


# results -------------------------------------------------------------------------------------------


def bounds(measured: Figures) -> list[Bound]:
    """Every bound with its figure."""
    median = {row.name: row.timing.median for row in measured.rows}
    return [
        Bound("two organs of which one is poked beside that one", median[BESIDE] / median[ALONE], 1.1, "x"),
        Bound("an organ that sleeps", 1e6 * median[ASLEEP] / ORGANS, 1.0, "us"),
    ]


def as_json(organ: Organ, scene: SceneFile | None, measured: Figures) -> dict[str, Any]:
    """All figures for machines; units stand in the names."""
    return {
        "benchmark": "scene",
        "organ": organ.name,
        "surface_points": organ.n_surface,
        "scene": None if scene is None else list(scene.names),
        "threads": 1,
        "force_n": FORCE,
        "noise": measured.noise,
        "rows": [
            {
                "name": row.name,
                "organs": row.organs,
                "median_us": 1e6 * row.timing.median,
                "p99_us": 1e6 * row.timing.p99,
                "samples": row.timing.samples,
                "share_of_tick": row.timing.median / TICK,
            }
            for row in measured.rows
        ],
        "bounds": [bound.as_json() for bound in bounds(measured)],
    }


def text(found: dict[str, Any]) -> str:
    """The tables for people."""
    lines = [
        f"organ '{found['organ']}', {found['surface_points']} surface points, {1e3 * APART:g} mm from the next one;"
        f" poked: {1e3 * found['force_n']:g} mN on a {PATCH_NODES}-node patch, swelling and ebbing 5 times a second",
        "processor time of one thread for a tick of 1 ms; all rows measured in turns in one run",
        "",
    ]
    lines += with_remarks(_table(found["rows"]))
    return "\n".join([*lines, "", *bound_lines(found["bounds"]), *noise_lines(found["noise"])])


def _table(rows: Sequence[dict[str, Any]]) -> list[list[str]]:
    table = [["", "organs", "median us", "p99 us", "samples", ""]]
    for row in rows:
        figures = [figure(row[key]) for key in ("median_us", "p99_us")]
        late = "more than a core keeps up with at 1 kHz" if row["share_of_tick"] > 1.0 else ""
        share = f"{100.0 * row['share_of_tick']:.0f} % of a core at 1 kHz"
        table.append([row["name"], str(row["organs"]), *figures, str(row["samples"]), late or share])
    return table
