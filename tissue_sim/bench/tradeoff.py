"""Benchmark `tissue_sim bench tradeoff`: run time against error for the package's models and their peers.

There is one run, one machine, one set of loads, one reference: nonlinear finite elements inside the organ's surface.
Every engine's displacements are transferred to the reference's points, between an engine's own points by its triangles:
so a coarse surface is charged for what it doesn't resolve, and all are compared at the same places.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from functools import partial
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from tissue_sim import progress
from tissue_sim.array_types import Floats
from tissue_sim.bench.arguments import add_shared
from tissue_sim.bench.peers.engine import Engine, Load
from tissue_sim.bench.peers.rows import CALIBRATED, Row, rows_of
from tissue_sim.bench.printing import Result, built_or_skipped, figure, noise_lines, with_remarks
from tissue_sim.bench.rows import each, report, stopped, until_stopped
from tissue_sim.bench.scaling import exponent
from tissue_sim.bench.sizes import Sized, sized
from tissue_sim.bench.timing import Burst, Phase, Timing, in_one_thread, interleave, noise_burst
from tissue_sim.bench.variants import fit_on_cluster, variants_of
from tissue_sim.calibration.cases import held_out_cases, scale_to_depth
from tissue_sim.calibration.fem import Body, volume_change
from tissue_sim.calibration.reference import Refined, finer_reference_body, refined
from tissue_sim.errors import UserError
from tissue_sim.json_types import JsonObject
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.shipped import shipped_organ

POINTS = (250, 500, 2000, 4000, 16_000)  # surface points, beside the organ's own
FEWEST, MOST = 100, 20_000
LOADS, QUICK_LOADS = (12, 4), (3, 1)  # smooth and sharp ones
TUNING = 2  # loads on which an engine with parameters of its own is tuned; drawn separately from the others
SEED, TUNING_SEED = 20061, 20062
NOISE = "noise"


class Case(NamedTuple):
    """Load on the reference's points, and the reference's displacements."""

    kind: str
    force: Floats  # (m, 3) N
    displacement: Floats  # (m, 3) m
    volume_change: float


class Error(NamedTuple):
    """Error of an engine under one load."""

    kind: str
    relative: float  # L2 over the reference's points
    rms: float  # m
    of_largest: float  # rms over the reference's largest displacement
    volume_change: float  # of what its own surface encloses
    settled: bool
    seconds: float  # to settle


class Evaluated(NamedTuple):
    """Row of the table; where it was skipped, errors are empty, update is None and the remark gives the reason."""

    name: str
    ours: bool
    points: int
    remark: str
    errors: list[Error]
    update: Timing | None  # s for an update
    simulated: float  # simulated s of an update


class Found(NamedTuple):
    """Results of the measuring process."""

    rows: list[Evaluated]
    cases: list[Case]
    nodes: int  # of the reference
    accuracy: str  # of the reference itself, one line
    noise: float | None  # None: not measured


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    add_shared(parser, out="write the plot of time against error there, as PNG")
    parser.add_argument(
        "--points",
        metavar="N,N",
        help=f"surface points to compare, in addition to the organ's own (default: {','.join(map(str, POINTS))};"
        " none with --quick)",
    )
    parser.add_argument(
        "--quick", action="store_true", help="fewer loads and only the organ's own points, in 2 minutes"
    )
    parser.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        help="use the workers of a Dask cluster for the fits; ticks are timed on this machine",
    )


def run(args: argparse.Namespace) -> Result:
    """Measure what the arguments ask for."""
    points = sizes_named(args.points) if args.points else () if args.quick else POINTS
    organ = Organ.load(args.organ or shipped_organ())
    start = time.perf_counter()
    if args.scheduler and not args.quick:
        fit_on_cluster(organ, sorted({organ.n_surface, *points}), args.scheduler)
    found = in_one_thread(measure, organ, points, args.quick)
    figures = as_json(organ, found, time.perf_counter() - start)
    if stopped():
        return Result(figures, text(figures))
    from tissue_sim.bench.tradeoff_plot import drawn

    return Result(figures, text(figures), {"tradeoff.png": partial(drawn, figures)})


def sizes_named(text: str) -> tuple[int, ...]:
    """Return the point counts of a text such as `250,500`; raises UserError where one is invalid."""
    try:
        points = tuple(int(word) for word in text.split(","))
    except ValueError:
        raise UserError(f"--points {text}: use numbers separated by commas, such as 250,500") from None
    for count in points:
        if not FEWEST <= count <= MOST:
            raise UserError(f"--points {count} is outside {FEWEST}..{MOST}")
    return points


# measuring -----------------------------------------------------------------------------------------


def measure(organ: Organ, points: Sequence[int], quick: bool) -> Found:
    """Return the reference, then every row at every size; meant for a process of one thread."""
    body, cases, tuning, accuracy = reference(organ, *(QUICK_LOADS if quick else LOADS))
    rows: list[tuple[Row, Sized]] = []
    for count in sorted({organ.n_surface, *points}):
        own = count == organ.n_surface
        variants = variants_of(body, count, fits=not quick, every_aim=own)
        size = sized(variants.plain, organ)
        rows += [
            (row, size) for row in rows_of(variants, [load_of(case, size) for case in tuning], own=own, quick=quick)
        ]
    measured, noise = measure_rows(rows, cases, 0.2 if quick else 1.0)
    return Found(measured, cases, body.n_nodes, str(accuracy), noise.p99 / noise.median if noise else None)


def measure_rows(
    rows: Sequence[tuple[Row, Sized]], cases: Sequence[Case], seconds: float
) -> tuple[list[Evaluated], Timing | None]:
    """Settle every row under every load, then time the updates of all in turns, and a fixed loop.

    What can't be made is skipped, and the remark gives the reason. When it was stopped before that, no time is known.
    """
    bursts: dict[str, Burst] = {NOISE: noise_burst}
    measured: list[Evaluated] = []
    with until_stopped():
        for number, (asked, size) in enumerate(each(rows, "rows")):
            engine, remark = built_or_skipped(asked.make)
            if engine is None:
                measured.append(Evaluated(asked.name, asked.ours, asked.points, remark, [], None, 1.0))
                continue
            errors = [error_of(engine, case, size) for case in progress.steps(cases, asked.name)]
            measured.append(Evaluated(asked.name, asked.ours, asked.points, remark, errors, None, engine.update))
            bursts[str(number)] = engine.burst(load_of(cases[0], size))
            report(
                f"{asked.name}, {asked.points} points", f"error {_mean([100.0 * one.relative for one in errors]):.1f} %"
            )
    timings = interleave(Phase(bursts, seconds, "updates"))
    return [one._replace(update=timings.get(str(number))) for number, one in enumerate(measured)], timings.get(NOISE)


def reference(organ: Organ, smooth: int, sharp: int) -> tuple[Body, list[Case], list[Case], Refined]:
    """Return the reference's body, the loads with its answers, those for tuning, and its accuracy.

    Raises UserError when it doesn't settle under a load.
    """
    body = Body(organ)
    drawn: list[tuple[str, Floats]] = []
    for cases, seed in (
        (held_out_cases(organ, smooth, sharp, SEED), SEED),
        (held_out_cases(organ, TUNING, 0, TUNING_SEED), TUNING_SEED),
    ):
        scaled = scale_to_depth(cases, body.settle_linear(cases.force), organ, seed)
        drawn += zip(scaled.kind, scaled.force, strict=True)
    forces = np.stack([force for _, force in drawn])
    finer = finer_reference_body(body, forces)
    linear, finer_linear = body.settle_linear(forces), finer.settle_linear(forces)
    accuracy = refined(body, finer, linear, finer_linear)
    answers = body.settle_many(forces)
    found = []
    for (kind, force), lacking, answer in zip(
        drawn,
        finer_linear - linear,
        progress.steps(answers, "reference", len(drawn)),
        strict=True,
    ):
        if not answer.converged:
            raise UserError(f"organ '{organ.name}': the finite elements do not converge under a load ({kind})")
        found.append(Case(kind, force, answer.displacement + lacking, answer.volume_change))
    return body, found[: smooth + sharp], found[smooth + sharp :], accuracy


def load_of(case: Case, size: Sized) -> Load:
    """Return a case as a load on another surface of the same body."""
    return Load(size.forces(case.force), size.reached(case.displacement))


def error_of(engine: Engine, case: Case, size: Sized) -> Error:
    """Settle an engine under a load, and compare."""
    answer = engine.settle(load_of(case, size))
    off = size.displacement(answer.displacement) - case.displacement
    rms = float(np.sqrt(np.mean(np.sum(off**2, axis=1))))
    return Error(
        case.kind,
        float(np.linalg.norm(off) / np.linalg.norm(case.displacement)),
        rms,
        rms / float(np.linalg.norm(case.displacement, axis=1).max()),
        volume_change(size.organ, answer.displacement),
        answer.settled,
        answer.seconds,
    )


# results -------------------------------------------------------------------------------------------


def as_json(organ: Organ, found: Found, seconds: float) -> JsonObject:
    """Return all figures for machines; units stand in the names."""
    rows = [_row_as_json(row) for row in found.rows]
    for row, best in zip(rows, pareto([(row["ms_per_ms"], row["mean_percent"]) for row in rows]), strict=True):
        row["pareto"] = best
    return {
        "benchmark": "tradeoff",
        "organ": organ.name,
        "surface_points": organ.n_surface,
        "threads": 1,
        "noise": found.noise,
        "seconds": seconds,
        "reference": {
            "name": "nonlinear FEM, neo-Hookean, quadratic tetrahedra",
            "nodes": found.nodes,
            "accuracy": found.accuracy,
            "volume_change_percent": _mean([100.0 * abs(case.volume_change) for case in found.cases]),
        },
        "loads": [
            {
                "kind": case.kind,
                "force_n": float(np.linalg.norm(case.force, axis=1).sum()),
                "largest_mm": 1e3 * float(np.linalg.norm(case.displacement, axis=1).max()),
                "volume_change_percent": 100.0 * case.volume_change,
            }
            for case in found.cases
        ],
        "growth": _growth([one for one in rows if one["name"] == CALIBRATED and one["ms_per_ms"] is not None]),
        "rows": rows,
    }


def _growth(sizes: list[JsonObject]) -> JsonObject | None:
    """Return how time and error of the calibrated organ change with its points; None for one size."""
    if len(sizes) < 2:
        return None
    points, times = ([row[key] for row in sizes] for key in ("points", "ms_per_ms"))
    errors = [row["mean_percent"] for row in sorted(sizes, key=lambda row: row["points"])]
    return {
        "points": [min(points), max(points)],
        "time_exponent": exponent(points, times),
        "error_falls": all(after <= before for before, after in pairwise(errors)),
    }


def _row_as_json(row: Evaluated) -> JsonObject:
    errors = row.errors
    sharp = [100.0 * error.relative for error in errors if error.kind == "sharp"]
    smooth = [100.0 * error.relative for error in errors if error.kind != "sharp"]
    return {
        "name": row.name,
        "ours": row.ours,
        "points": row.points,
        "remark": row.remark,
        "ms_per_ms": row.update.median / row.simulated if row.update else None,
        "update_ms": 1e3 * row.update.median if row.update else None,
        "update_p99_ms": 1e3 * row.update.p99 if row.update else None,
        "settle_ms": 1e3 * float(np.median([error.seconds for error in errors])) if errors else None,
        "settled": sum(error.settled for error in errors),
        "mean_percent": _mean([*smooth, *sharp]),
        "smooth_percent": _mean(smooth),
        "sharp_percent": _mean(sharp),
        "worst_percent": max([*smooth, *sharp], default=None),
        "rms_mm": _mean([1e3 * error.rms for error in errors]),
        "rms_over_max_percent": _mean([100.0 * error.of_largest for error in errors]),
        "volume_change_percent": _mean([100.0 * abs(error.volume_change) for error in errors]),
        "errors": [error._asdict() for error in errors],
    }


def _mean(values: Sequence[float]) -> float | None:
    return float(np.mean(values)) if values else None


def pareto(costs: Sequence[tuple[float | None, float | None]]) -> list[bool]:
    """Return which pairs of time and error are on the Pareto front; a pair with None isn't.

    Errors that differ by less than a thousandth are equal.
    """
    known = [(time, float(f"{error:.3g}")) for time, error in costs if time is not None and error is not None]

    def beaten(time: float, error: float) -> bool:
        return any(t <= time and e <= error and (t < time or e < error) for t, e in known)

    return [time is not None and error is not None and not beaten(time, float(f"{error:.3g}")) for time, error in costs]


def text(found: JsonObject) -> str:
    """Return the table to be printed."""
    reference, loads = found["reference"], found["loads"]
    sharp = sum(load["kind"] == "sharp" for load in loads)
    depths = [load["largest_mm"] for load in loads]
    lines = [
        f"organ '{found['organ']}', {found['surface_points']} surface points; {len(loads)} loads, {sharp} of them"
        f" sharp, {min(depths):.1f} to {max(depths):.1f} mm deep",
        f"reference: {reference['name']}, {reference['nodes']} nodes; its volume changes by"
        f" {reference['volume_change_percent']:.2f} % on average",
        f"its own error: {reference['accuracy']}",
        "processor time of one thread, updates measured in turn; engines without steps are solved once per ms",
        "",
    ]
    head = [
        "",
        "points",
        "ms per ms",
        "ms to converge",
        "L2 %",
        "worst %",
        "sharp %",
        "RMS mm",
        "RMS/max %",
        "volume %",
    ]
    table = [[*head, "settled", ""]]
    for row in found["rows"]:
        if not row["errors"]:
            continue
        time_a_ms = "-" if row["ms_per_ms"] is None else figure(row["ms_per_ms"])
        figures = [f"{row['points']}", time_a_ms, figure(row["settle_ms"])]
        figures += [f"{row[key]:.1f}" for key in ("mean_percent", "worst_percent", "sharp_percent")]
        figures += [f"{row['rms_mm']:.2f}", f"{row['rms_over_max_percent']:.1f}", f"{row['volume_change_percent']:.2f}"]
        figures += [f"{row['settled']}/{len(row['errors'])}"]
        table.append([row["name"] + (" *" if row["pareto"] else ""), *figures, row["remark"]])
    lines += with_remarks(table)
    lines.append("* on the Pareto front of ms per ms and L2: nothing else is both faster and more accurate")
    growth = found["growth"]
    if growth:
        first, last = growth["points"]
        errors = "decreases with every size" if growth["error_falls"] else "does not decrease with every size"
        lines.append(
            f"{CALIBRATED}, {first} to {last} points: time grows as n^{growth['time_exponent']:.2f}, the error {errors}"
        )
    skipped = {(row["name"], row["remark"]): None for row in found["rows"] if not row["errors"]}
    lines += [f"{name}: {remark}" for name, remark in skipped]
    return "\n".join(lines + noise_lines(found["noise"]))
