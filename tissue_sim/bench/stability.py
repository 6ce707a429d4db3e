"""Benchmark `tissue_sim bench stability`: map of where each integrator and local region is stable."""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path

from tissue_sim import progress
from tissue_sim.bench import rows
from tissue_sim.bench.arguments import add_shared
from tissue_sim.bench.printing import Bound, Result
from tissue_sim.bench.processes import on_all_cores
from tissue_sim.bench.sweeps.cells import AXES, QUICK_AXES, SMALL_ORGAN, Cell, axes_named, cells_of
from tissue_sim.bench.sweeps.stability_map import drawn
from tissue_sim.bench.sweeps.trial import Record, run_cell
from tissue_sim.bench.sweeps.trial_simulations import made_for, organ_of, simulation_of
from tissue_sim.calibration.cohort import on_cluster
from tissue_sim.errors import UserError
from tissue_sim.json_types import JsonObject
from tissue_sim.model.data.settings import LOCAL_REGIONS
from tissue_sim.model.regions.region_tables import moves_whole
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.shipped import shipped_organ
from tissue_sim.outputs import write_json

OUTCOMES = ("stable", "guarded", "diverged")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    add_shared(
        parser,
        organ="the kidney of this package, a small ellipsoid with --quick",
        out="write stability.png and stability.json there",
    )
    parser.add_argument("--quick", action="store_true", help="fewer runs and shorter times, within a minute")
    parser.add_argument(
        "--axes",
        metavar="A,B",
        help=f"axes of {', '.join(AXES)}; force and depth select all of their axes (default: all, fewer with --quick)",
    )
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="processes")
    parser.add_argument("--scheduler", metavar="ADDRESS", help="use the workers of a Dask cluster")
    parser.add_argument("--check", action="store_true", help="exit with 1 when a run with default settings diverged")


def run(args: argparse.Namespace) -> Result:
    """Measure what the arguments ask for."""
    axes = axes_named(args.axes or (",".join(QUICK_AXES) if args.quick else "all"))
    if args.jobs < 1:
        raise UserError(f"--jobs {args.jobs} is less than 1")
    organ = args.organ or (SMALL_ORGAN if args.quick else str(shipped_organ()))
    cells = cells_of(axes, organ, args.quick, regions_of(organ_of(organ)))
    start = time.perf_counter()
    records = sweep(cells, args.jobs, args.scheduler)
    seconds = time.perf_counter() - start
    report = _report(records, organ, args.quick, seconds)
    shown = summary(records, seconds)
    if args.json == "-":
        print(shown, file=sys.stderr)
    if args.out:
        write_json(Path(args.out) / "stability.json", report)
    return Result(report, shown, {"stability.png": partial(drawn, records, str(report["organ"]))})


def regions_of(organ: Organ) -> tuple[str, ...]:
    """Return the local regions to try: where `auto` moves all of an organ's cells, it equals `off`."""
    same = len(organ.cell_nodes) > 0 and moves_whole(organ)
    return tuple(region for region in LOCAL_REGIONS if not (same and region == "auto"))


def sweep(cells: Sequence[Cell], jobs: int, scheduler: str | None = None) -> list[Record]:
    """Run the cells on `jobs` processes or a cluster, with progress; return the records in the order of the cells.

    Raises UserError when the cluster's scheduler doesn't answer, and what the first simulation raises.
    """
    _compile(cells)
    found: dict[tuple[str, float, str, str], Record] = {}
    order = sorted(cells, key=made_for)  # cells that use the same simulation are adjacent
    outcomes: Counter[str] = Counter()
    with rows.until_stopped(), progress.task("cells", len(cells)) as under_way:
        for record in _records(order, jobs, scheduler):
            found[record.axis, record.value, record.integrator, record.local_region] = record
            rows.keep()
            outcomes[record.outcome] += 1
            under_way.advance(1, ", ".join(f"{count} {outcome}" for outcome, count in sorted(outcomes.items())))
    keys = [(cell.axis, cell.value, cell.integrator, cell.local_region) for cell in cells]
    return [found[key] for key in keys if key in found]


def _records(cells: Sequence[Cell], jobs: int, scheduler: str | None) -> Iterator[Record]:
    """Yield the records as they are ready."""
    if scheduler is None:
        yield from on_all_cores(run_cell, [(cell,) for cell in cells], jobs, ordered=False)
        return
    for _, record in on_cluster(run_cell, cells, scheduler):
        if isinstance(record, UserError):
            raise record
        yield record


def violations(records: Sequence[Record]) -> list[Record]:
    """Return the records that break the requirement on the default settings."""
    return [record for record in records if record.judged and record.outcome == "diverged"]


def summary(records: Sequence[Record], seconds: float) -> str:
    """Return what the terminal shows: counts by axis, then every cell that breaks the requirement."""
    lines = [
        f"{'axis':12} {'cells':>6} {'stable':>7} {'guarded':>8} {'diverged':>9} {'recovered':>9} {'violations':>11}"
    ]
    for axis in dict.fromkeys(record.axis for record in records):
        some = [record for record in records if record.axis == axis]
        outcome = Counter(record.outcome for record in some)
        led = sum(record.snaps > 0 for record in some)
        lines.append(
            f"{axis:12} {len(some):6} {outcome['stable']:7} {outcome['guarded']:8} {outcome['diverged']:9}"
            f" {led:9} {len(violations(some)):11}"
        )
    broken = violations(records)
    judged = sum(record.judged for record in records)
    lines.append(
        f"{len(records)} runs in {seconds:.0f} s; with default settings {judged}, of which {len(broken)} failed"
    )
    for record in broken:
        lines.append(
            f"  {record.axis} {record.value:g}, {record.integrator}, region {record.local_region}:"
            f" {'; '.join(record.problems)}"
        )
    return "\n".join(lines)


def _report(records: Sequence[Record], organ: str, quick: bool, seconds: float) -> JsonObject:
    broken = violations(records)
    return {
        "organ": organ_of(organ).name,
        "quick": quick,
        "seconds": seconds,
        "axes": {axis: AXES[axis].title for axis in dict.fromkeys(record.axis for record in records)},
        "summary": {
            **{outcome: sum(record.outcome == outcome for record in records) for outcome in OUTCOMES},
            "led_back": sum(record.snaps > 0 for record in records),
            "judged": sum(record.judged for record in records),
            "violations": [[r.axis, r.value, r.integrator, r.local_region, list(r.problems)] for r in broken],
        },
        "cells": [record.as_json() for record in records],
        "bounds": [Bound("failed runs with default settings", len(broken), 0.0, "").as_json()],
    }


def _compile(cells: Sequence[Cell]) -> None:
    """Compile here, once, what every worker then reads from the disk."""
    for integrator in dict.fromkeys(cell.integrator for cell in cells):
        simulation_of(next(cell for cell in cells if cell.integrator == integrator)).step()
