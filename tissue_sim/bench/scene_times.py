"""Benchmark `tissue_sim bench scene`: cost of organs beside each other, and of a scene that breathes.

Everything that is compared is measured in one run, in turns, in one process with one thread.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

import numba
import numpy as np

from tissue_sim import progress
from tissue_sim.array_types import Floats, Longs
from tissue_sim.bench.arguments import add_shared
from tissue_sim.bench.organs import PATCH_NODES, patch_load, press_node
from tissue_sim.bench.printing import Bound, Result, bound_lines, figure, noise_lines, with_remarks
from tissue_sim.bench.tick_rows import FORCE
from tissue_sim.bench.timing import (
    Burst,
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
from tissue_sim.contact.scene import Scene
from tissue_sim.contact.scene_file import SceneFile
from tissue_sim.contact.tools import Tool
from tissue_sim.errors import UserError
from tissue_sim.json_types import JsonObject
from tissue_sim.model.data.world import World
from tissue_sim.model.joined import Joined
from tissue_sim.model.simulation import Simulation
from tissue_sim.model.stepping.coupled_step import CoupledOrgans, tick_coupled
from tissue_sim.model.stepping.inputs import load_nodes
from tissue_sim.model.stepping.wake_threshold import WAKE_DISPLACEMENT, WAKE_FORCE
from tissue_sim.organ.normals import surface_normals
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.placement import placed
from tissue_sim.organ.shipped import shipped_file, shipped_organ

ORGANS = 4
APART = 0.2  # m, so that none touches another
SECONDS, QUICK_SECONDS = 2.0, 0.3  # of measurement of each row
TICK = 1e-3  # s of simulated time

SHIPPED = "config/scenes/abdomen.yaml"
LOOK = 20  # ticks between two searches for contacts
TOOL, DEEP, AWAY, APPROACH = 0.005, 0.002, 0.004, 200  # m; m pressed in, from so far outside; ticks for that

ALONE, BESIDE, ASLEEP, AWAKE = "one organ, poked", "two, one poked", "all asleep", "all poked"
SCENE, TOUCHED = "the scene, all poked", "the scene, a tool on each"
NOISE = "noise"
LEAST_BREATH = 1.0  # s
# Time of the abdomen relative to a kidney alone: 200 and 300 us where that takes 88.
MOST_ONE, MOST_TOUCHED = 2.27, 3.41


class Row(NamedTuple):
    """Name, number of organs and timing of a row."""

    name: str
    organs: int
    timing: Timing


class WakeThresholdError(NamedTuple):
    """Deviation of a scene with a wake threshold and coarse steps from one without either.

    Measured over a breath, or LEAST_BREATH s, with a ball pressed into the first organ.
    """

    moved: float  # m, of any node
    force: float  # N, of the haptic output
    awake: float  # organs awake on average, with the threshold
    awake_of_all: float  # likewise, without it


class Figures(NamedTuple):
    """Results of the measuring process."""

    rows: list[Row]
    noise: float  # p99 over median of a fixed loop
    lacking: WakeThresholdError | None  # of a scene of several organs


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    add_shared(parser, check=True)
    parser.add_argument("--scene", metavar="FILE", help="scene (.yaml) to time; default: the abdomen of this package")
    parser.add_argument("--quick", action="store_true", help="fewer samples")


def run(args: argparse.Namespace) -> Result:
    """Measure what the arguments ask for."""
    organ = Organ.load(Path(args.organ) if args.organ else shipped_organ())
    scene = SceneFile.read(Path(args.scene) if args.scene else shipped_scene())
    measured = in_one_thread(measure, organ, scene, QUICK_SECONDS if args.quick else SECONDS)
    found = as_json(organ, scene, measured)
    return Result(found, text(found))


def shipped_scene() -> Path:
    """Return the path of the abdomen that ships. Raises UserError when it is missing."""
    found = shipped_file(SHIPPED)
    if found is None:
        raise UserError(f"{SHIPPED} is not part of this installation; name a scene with --scene")
    return found


# measuring -----------------------------------------------------------------------------------------


def measure(organ: Organ, scene: SceneFile, seconds: float) -> Figures:
    """Time every row; meant for a process of one thread."""
    with progress.task("preparing"):
        bursts: dict[str, Burst] = {
            ALONE: Ticks(Simulation(organ), *patch_load(organ, FORCE)),
            BESIDE: JoinedTicks(apart(organ, 2), range(1)),
            ASLEEP: JoinedTicks(apart(organ, ORGANS), ()),
            AWAKE: JoinedTicks(apart(organ, ORGANS), range(ORGANS)),
        }
    organs = {ALONE: 1, BESIDE: 2, ASLEEP: ORGANS, AWAKE: ORGANS}
    if len(scene.organs) > 1:
        count = len(scene.organs)
        rows = {one_poked(name): scene_ticks(scene, [number]) for number, name in enumerate(scene.names)}
        rows[SCENE], rows[TOUCHED] = scene_ticks(scene, range(count)), touched_ticks(scene)
        bursts |= rows
        organs |= dict.fromkeys(rows, count)
    timings = interleave(Phase(bursts | {NOISE: noise_burst}, seconds, "scene"))
    noise = timings.pop(NOISE)
    rows_of = [Row(name, organs[name], timing) for name, timing in timings.items()]
    return Figures(rows_of, noise.p99 / noise.median, lacking(scene) if len(scene.organs) > 1 else None)


def one_poked(name: str) -> str:
    """Return the name of the row of a scene in which one organ is poked."""
    return f"the scene, {name} poked"


def scene_ticks(scene: SceneFile, poked: Iterable[int]) -> JoinedTicks:
    """Return ticks of a scene in which the organs with these numbers are poked."""
    return _ticks_of(scene.scene([], ticks_a_set=LOOK), poked, lambda: None)


def touched_ticks(scene: SceneFile) -> JoinedTicks:
    """Return ticks of a scene in which a ball is pressed into every organ, and moves with it as it breathes."""
    made, press = _pressed(scene, len(scene.organs))
    return _ticks_of(made, (), press)


def lacking(scene: SceneFile) -> WakeThresholdError:
    """Compare a scene with itself without a wake threshold and without coarse steps."""
    scenes = [_pressed(scene, 1) for _ in range(2)]
    (some, _), (everything, _) = scenes
    everything.joined.threshold.limits[:] = 0.0
    everything.joined.coarse.square[:] = 0.0
    seconds = max(LEAST_BREATH, float(some.joined.carried.breath.period))
    moved = force = 0.0
    awake, ticks = np.zeros(2), round(seconds / TICK)
    for tick in progress.steps(range(ticks), "loads below the wake threshold"):
        for number, (made, press) in enumerate(scenes):
            if tick % LOOK == 0:
                press()
            made.step()
            awake[number] += sum(not one.asleep for one in made.simulations)
        for one, other in zip(some.simulations, everything.simulations, strict=True):
            moved = max(moved, float(np.linalg.norm(one.positions - other.positions, axis=1).max()))
        force = max(force, float(np.linalg.norm(some.wrenches[:, :3] - everything.wrenches[:, :3])))
    return WakeThresholdError(moved, force, *(awake / ticks))


def _pressed(scene: SceneFile, count: int) -> tuple[Scene, Callable[[], None]]:
    """Return a scene with a ball pressed into each of its first organs, and what keeps the balls there."""
    made = scene.scene([Tool(f"{name}_tool", "sphere", radius=TOOL) for name in scene.names[:count]], ticks_a_set=LOOK)
    places, normals = zip(*(_place_of(one) for one in scene.organs[:count]), strict=True)

    def press(deep: float = DEEP) -> None:
        for tool, (place, normal) in enumerate(zip(places, normals, strict=True)):
            made.move(tool, place + made.offsets[tool] + (TOOL - deep) * normal)

    for tick in range(APPROACH):
        press(DEEP - (DEEP + AWAY) * (1.0 - tick / APPROACH))
        made.step()
    return made, press


def _place_of(organ: Organ) -> tuple[Floats, Floats]:
    """Return a point of the surface to press at, and its normal, (3,) each."""
    node = press_node(organ)
    return organ.surface_positions[node], surface_normals(organ.surface_positions, organ.surface_triangles)[node]


def _ticks_of(scene: Scene, poked: Iterable[int], move: Callable[[], None]) -> JoinedTicks:
    def look() -> None:
        move()
        scene.find()

    return JoinedTicks(scene.joined, poked, look)


def apart(organ: Organ, count: int) -> Joined:
    """Return `count` copies of an organ in a row, not joined."""
    simulations = [Simulation(placed(organ, (APART * place, 0.0, 0.0))) for place in range(count)]
    return Joined(simulations)


class JoinedTicks:
    """Bursts of ticks of organs that are advanced together, of which those `poked` are, as in Ticks.

    look: called every LOOK ticks, and not timed; finds what touches.
    """

    def __init__(self, joined: Joined, poked: Iterable[int], look: Callable[[], None] = lambda: None) -> None:
        self.joined, self._look, chosen = joined, look, set(poked)
        none = np.zeros(0, dtype=np.int64), np.zeros((0, 3))
        loads = [
            patch_load(one.organ, FORCE) if place in chosen else none for place, one in enumerate(joined.simulations)
        ]
        self._loads = tuple((nodes, np.ascontiguousarray(forces)) for nodes, forces in loads)
        self._phase, self._clock = np.zeros(1, dtype=np.int64), np.zeros(2, dtype=np.int64)

    def __call__(self, count: int) -> Floats:
        """Return seconds (count,) of `count` ticks, after two before each LOOK of them that warm the caches."""
        return np.concatenate([self._look_and_tick(min(LOOK, count - first)) for first in range(0, count, LOOK)])

    def _look_and_tick(self, count: int) -> Floats:
        self._look()
        times = np.zeros(count + 2, dtype=np.int64)
        _time_joined(self.joined.worlds, self.joined.handle, self._loads, self._phase, self._clock, times)
        return np.maximum(1e-9 * times[2:] - clock_cost(), 0.0)


@numba.njit(nogil=True, error_model="numpy")
def _time_joined(
    worlds: Sequence[World],
    joined: CoupledOrgans,
    loads: Sequence[tuple[Longs, Floats]],
    phase: Longs,
    clock: Longs,
    times: Longs,
) -> None:
    """Step len(times) ticks and write the ns that each took, in a compiled loop as in the node."""
    for index in range(len(times)):
        fraction = swelling(phase)
        for organ in range(len(worlds)):
            nodes, forces = loads[organ]
            if len(nodes) > 0:
                load_nodes(worlds[organ].state, nodes, fraction * forces)
        start = now(clock)
        tick_coupled(worlds, joined)
        times[index] = now(clock) - start


# results -------------------------------------------------------------------------------------------


def bounds(measured: Figures) -> list[Bound]:
    """Return every bound with its figure."""
    median = {row.name: row.timing.median for row in measured.rows}
    found = [
        Bound(
            "two organs of which one is poked, relative to that one alone", median[BESIDE] / median[ALONE], 1.05, "x"
        ),
        Bound("an organ that sleeps", 1e6 * median[ASLEEP] / ORGANS, 1.0, "us"),
    ]
    if TOUCHED in median:
        others = {ALONE, BESIDE, ASLEEP, AWAKE, SCENE, TOUCHED}
        one = max(time for name, time in median.items() if name not in others)
        found += [
            Bound("the scene, any one poked, relative to one organ alone", one / median[ALONE], MOST_ONE, "x"),
            Bound(
                "the scene, a tool on each, relative to one organ alone",
                median[TOUCHED] / median[ALONE],
                MOST_TOUCHED,
                "x",
            ),
        ]
    if measured.lacking is not None:
        found += [
            Bound("error of organs with a wake threshold", 1e3 * measured.lacking.moved, 1e3 * WAKE_DISPLACEMENT, "mm"),
            Bound("error of the haptic output on one", 1e3 * measured.lacking.force, 1e3 * WAKE_FORCE, "mN"),
        ]
    return found


def as_json(organ: Organ, scene: SceneFile, measured: Figures) -> JsonObject:
    """Return all figures for machines; units stand in the names."""
    return {
        "benchmark": "scene",
        "organ": organ.name,
        "surface_points": organ.n_surface,
        "scene": list(scene.names),
        "threads": 1,
        "force_n": FORCE,
        "noise": measured.noise,
        "organs_awake": None if measured.lacking is None else measured.lacking.awake,
        "organs_awake_without_threshold": None if measured.lacking is None else measured.lacking.awake_of_all,
        "rows": [
            {
                "name": row.name,
                "organs": row.organs,
                "median_us": 1e6 * row.timing.median,
                "p99_us": 1e6 * row.timing.p99,
                "samples": row.timing.samples,
                "fraction_of_tick": row.timing.median / TICK,
            }
            for row in measured.rows
        ],
        "bounds": [bound.as_json() for bound in bounds(measured)],
    }


def text(found: JsonObject) -> str:
    """Return the tables to be printed."""
    lines = [
        f"organ '{found['organ']}', {found['surface_points']} surface points, {1e3 * APART:g} mm from the next one;"
        f" poked: {1e3 * found['force_n']:g} mN on a {PATCH_NODES}-node patch, oscillating 5 times a second",
        "processor time of one thread for a tick of 1 ms; all rows measured in turn in one run",
        "",
    ]
    lines += with_remarks(_table(found["rows"]))
    if found["organs_awake"] is not None:
        awake, of_all = found["organs_awake"], found["organs_awake_without_threshold"]
        lines += ["", f"a breath of the scene with a tool on {found['scene'][0]}: {awake:.2f} organs awake on average,"]
        lines[-1] += f" {of_all:.2f} if they respond to all loads"
    return "\n".join([*lines, "", *bound_lines(found["bounds"]), *noise_lines(found["noise"])])


def _table(rows: Sequence[JsonObject]) -> list[list[str]]:
    table = [["", "organs", "median us", "p99 us", "samples", ""]]
    for row in rows:
        figures = [figure(row[key]) for key in ("median_us", "p99_us")]
        late = "more than one core can compute at 1 kHz" if row["fraction_of_tick"] > 1.0 else ""
        fraction = f"{100.0 * row['fraction_of_tick']:.0f} % of a core at 1 kHz"
        table.append([row["name"], str(row["organs"]), *figures, str(row["samples"]), late or fraction])
    return table
