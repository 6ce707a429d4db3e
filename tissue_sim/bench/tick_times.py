"""Benchmark `tissue_sim bench tick`: time of a tick, beside the same loop in C, MuJoCo flex and a compliance.

Everything that is compared is measured in one run, in turns, in one process with one thread.
"""

from __future__ import annotations

import argparse
import time
from functools import partial
from pathlib import Path
from typing import NamedTuple

from tissue_sim.bench import scaling as growth
from tissue_sim.bench.arguments import AS_BUILT_ORGAN, add_shared
from tissue_sim.bench.organs import PATCH_NODES, patch_load
from tissue_sim.bench.plots import drawn_growth, drawn_rows
from tissue_sim.bench.printing import Bound, Result, aligned, bound_lines, figure, noise_lines, with_remarks
from tissue_sim.bench.tick_rows import (
    ASLEEP,
    C_PLAIN,
    CELL_C,
    CELL_SUBSTEP,
    CELLS,
    FLEX,
    FORCE,
    GUARD,
    MODAL,
    MODAL_CELLS,
    PRODUCT,
    RELAXING_SUBSTEP,
    STIFFENING,
    STIFFENING_SUBSTEP,
    SUBSTEP,
    WHOLE,
    make_bursts,
    makers_of,
)
from tissue_sim.bench.timing import Phase, Ticks, Timing, in_one_thread, interleave, noise_burst
from tissue_sim.jit import is_compiled
from tissue_sim.json_types import JsonObject
from tissue_sim.model.simulation import Simulation
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.shipped import AS_BUILT, shipped_organ

NOISE = "noise"


class Line(NamedTuple):
    """Line of the table: what was timed (None: skipped, and why), and a remark."""

    name: str
    timing: Timing | None
    remark: str


class Figures(NamedTuple):
    """Results of the measuring process."""

    rows: list[Line]
    noise: float  # p99 over median of a fixed loop
    load_seconds: float  # s to the first tick with the kernels as they were found
    compiled_before: bool
    loop_seconds: float  # s of compiling the benchmark's own loop
    grown: list[growth.Grown]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    add_shared(parser, organ=AS_BUILT_ORGAN, out="write plots there, as PNG", check=True)
    parser.add_argument("--quick", action="store_true", help="fewer samples, no organ over 4000 points")


def run(args: argparse.Namespace) -> Result:
    """Measure what the arguments ask for."""
    path = Path(args.organ) if args.organ else shipped_organ(AS_BUILT)
    organ = Organ.load(path)
    measured = in_one_thread(measure, organ, args.quick)
    found = as_json(organ, measured)
    return Result(
        found, text(found), {"tick.png": partial(drawn_rows, found), "growth.png": partial(drawn_growth, found)}
    )


# measuring -----------------------------------------------------------------------------------------


def measure(organ: Organ, quick: bool) -> Figures:
    """Time every row and the growth; meant for a process of one thread."""
    compiled_before = is_compiled()
    start = time.perf_counter()
    Simulation(organ).step()
    load_seconds = time.perf_counter() - start
    start = time.perf_counter()
    Ticks(Simulation(organ), *patch_load(organ, FORCE))(1)
    loop_seconds = time.perf_counter() - start
    bursts, remarks = make_bursts(makers_of(organ))
    timings = interleave(Phase(bursts | {NOISE: noise_burst}, 0.3 if quick else 2.0, "ticks"))
    noise = timings[NOISE]
    rows = [Line(name, timings.get(name), remark) for name, remark in remarks.items()]
    grown = growth.measure(growth.QUICK_SIZES if quick else growth.SIZES, 0.3 if quick else 2.0)
    return Figures(rows, noise.p99 / noise.median, load_seconds, compiled_before, loop_seconds, grown)


# results -------------------------------------------------------------------------------------------


def bounds(measured: Figures) -> list[Bound]:
    """Return every bound with its figure."""
    median = {row.name: row.timing.median for row in measured.rows if row.timing}
    grown = growth.as_json(measured.grown)

    def us(name: str) -> float | None:
        return 1e6 * median[name] if name in median else None

    def ratio(one: str, other: str) -> float | None:
        return median[one] / median[other] if one in median and other in median else None

    points = [size.points for size in measured.grown] or growth.SIZES
    first, last = points[0], points[-1]
    return [
        Bound("whole hybrid tick", us(WHOLE), 300.0, "us"),
        Bound("whole tick of cells", us(CELLS), 100.0, "us"),
        Bound("guard, fraction of the whole hybrid tick", _percent(ratio(GUARD, WHOLE)), 2.0, "%"),
        Bound("substep relative to the same in C, -O3", ratio(SUBSTEP, C_PLAIN), 1.3, "x"),
        Bound("substep of cells relative to the same in C", ratio(CELL_SUBSTEP, CELL_C), 1.0, "x"),
        Bound("tick of cells that stiffen relative to cells that don't", ratio(STIFFENING, CELLS), 1.15, "x"),
        Bound("substep of cells that stiffen, likewise", ratio(STIFFENING_SUBSTEP, CELL_SUBSTEP), 1.15, "x"),
        Bound("substep of cells that relax, likewise", ratio(RELAXING_SUBSTEP, CELL_SUBSTEP), 1.15, "x"),
        Bound("modal tick, 19-node contact", us(MODAL), 25.0, "us"),
        Bound("modal tick of cells, 19-node contact", us(MODAL_CELLS), 20.0, "us"),
        Bound("modal tick relative to the compliance of that patch", ratio(MODAL, PRODUCT), 1.0, "x"),
        Bound("asleep tick", us(ASLEEP), 3.0, "us"),
        Bound("MuJoCo flex relative to the whole tick of cells", ratio(FLEX, CELLS), 150.0, "x", least=True),
        Bound(f"growth of a substep, {first} to {last} points", grown["substep_exponent"], 1.1, "power"),
        Bound(f"modal tick at {last} relative to {first} points", grown["modal_ratio"], 2.0, "x"),
    ]


def _percent(fraction: float | None) -> float | None:
    return None if fraction is None else 100.0 * fraction


def as_json(organ: Organ, measured: Figures) -> JsonObject:
    """Return all figures for machines; units stand in the names."""
    whole = next((row.timing.median for row in measured.rows if row.name == WHOLE and row.timing), None)
    return {
        "benchmark": "tick",
        "organ": organ.name,
        "surface_points": organ.n_surface,
        "threads": 1,
        "patch_nodes": PATCH_NODES,
        "force_n": FORCE,
        "noise": measured.noise,
        "compile": {
            "kernels_found_on_disk": measured.compiled_before,
            "first_tick_s": measured.load_seconds,
            "benchmark_loop_s": measured.loop_seconds,
        },
        "rows": [
            {
                "name": row.name,
                "median_us": 1e6 * row.timing.median if row.timing else None,
                "p99_us": 1e6 * row.timing.p99 if row.timing else None,
                "samples": row.timing.samples if row.timing else 0,
                "of_whole_tick": row.timing.median / whole if row.timing and whole else None,
                "remark": row.remark,
            }
            for row in measured.rows
        ],
        "growth": growth.as_json(measured.grown),
        "bounds": [bound.as_json() for bound in bounds(measured)],
    }


def text(found: JsonObject) -> str:
    """Return the tables to be printed."""
    lines = [
        f"organ '{found['organ']}', {found['surface_points']} surface points; a tick is 1 ms of simulated time;"
        f" {1e3 * found['force_n']:g} mN on a {found['patch_nodes']}-node patch, oscillating 5 times a second",
        "processor time of one thread; all rows measured in turn in one run",
        "",
    ]
    table = [["", "median us", "p99 us", "samples", "of whole tick", ""]]
    for row in found["rows"]:
        if row["median_us"] is None:
            table.append([row["name"], "-", "-", "0", "-", row["remark"]])
            continue
        figures = [figure(row[key]) for key in ("median_us", "p99_us")]
        table.append([row["name"], *figures, str(row["samples"]), f"{row['of_whole_tick']:.3g}", row["remark"]])
    lines += with_remarks(table)
    lines += ["", *_growth_lines(found["growth"]), ""]
    compiled = found["compile"]
    kept = "read from disk" if compiled["kernels_found_on_disk"] else "compiled"
    lines.append(
        f"compile time, not included above: kernels {kept} in {compiled['first_tick_s']:.1f} s, the benchmark's own"
        f" loop compiled in {compiled['benchmark_loop_s']:.1f} s"
    )
    lines.append("")
    lines += bound_lines(found["bounds"])
    return "\n".join(lines + noise_lines(found["noise"]))


def _growth_lines(found: JsonObject) -> list[str]:
    table = [["points", "whole us", "substeps", "us a substep", "modal us", "modal substeps", "nodes", "modes", "s"]]
    for size in found["sizes"]:
        row = [str(size["points"]), figure(size["whole_us"]), str(size["substeps"]), figure(size["substep_us"])]
        row += [figure(size["modal_us"]), str(size["modal_substeps"]), str(size["modal_nodes"])]
        table.append([*row, f"{size['modes']} by {size['modes_by']}", f"{size['modes_s']:.1f}"])
    lines = aligned(table, left=0)
    if found["substep_exponent"] is not None:
        lines.append(
            f"a substep grows as n^{found['substep_exponent']:.2f}, the whole tick as"
            f" n^{found['tick_exponent']:.2f}: shorter edges require more substeps; the same pressure on 19 nodes at"
            " every size"
        )
    return lines
