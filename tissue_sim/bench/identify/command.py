"""Benchmark `tissue_sim bench identify`: what the identification finds in measured presses, and in known ones."""

from __future__ import annotations

import argparse
from pathlib import Path

from tissue_sim.bench import rows
from tissue_sim.bench.arguments import add_shared
from tissue_sim.bench.identify import coverage, inclusions, palpation_sets, synthetic
from tissue_sim.bench.printing import Bound, Result, aligned, bound_lines
from tissue_sim.bench.timing import in_one_thread
from tissue_sim.json_types import JsonObject
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.shipped import shipped_organ

PHANTOM, PHANTOM_MAPPED, MEAT_MAPPED = 6.0, 4.5, 12.0  # %
OFF, OFF_OFFSETS = 5.0, 8.0  # %
HELD, MOST_HELD = 90.0, 97.0  # % of the intervals; above, they are too wide
REPORTED, FALSE = 90.0, 5.0  # % of the runs: a stiff place reported over an unknown inclusion, and where none is


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    add_shared(parser, check=True)
    parser.add_argument(
        "--data", metavar="FOLDER", help="folder of measured presses; without it, only presses by finite elements"
    )
    parser.add_argument("--runs", type=int, default=synthetic.RUNS, metavar="N", help="runs of each synthetic case")


def run(args: argparse.Namespace) -> Result:
    """Measure what the arguments ask for."""
    if args.data:
        palpation_sets.check_data(Path(args.data))
    organ = Organ.load(args.organ or shipped_organ("kidney"))
    found = in_one_thread(measure, organ, args.runs, args.data)
    return Result(found, text(found))


def measure(organ: Organ, runs: int, data: str | None) -> JsonObject:
    """Return all figures and bounds."""
    known = synthetic.as_rows(synthetic.measure(organ, runs)) if runs > 0 else []
    exact = synthetic.as_rows(coverage.measure(runs)) if runs > 0 and not rows.stopped() else []
    around: list[JsonObject] = []
    if runs > 0 and not rows.stopped():
        with_one = organ if len(organ.inclusion_stiffness) else Organ.load(shipped_organ("kidney_tumour"))
        around = inclusions.as_rows(inclusions.measure(with_one, runs))
    sets = [] if data is None or rows.stopped() else palpation_sets.as_rows(palpation_sets.measure(Path(data)))
    repeat = [100.0 * error for error in palpation_sets.repeat_errors(Path(data))] if data is not None else []
    bounds = [
        one.as_json()
        for one in [*_known_bounds(known), *_exact_bounds(exact), *_inclusion_bounds(around), *_set_bounds(sets)]
    ]
    return {
        "known": known,
        "exact": exact,
        "inclusions": around,
        "sets": sets,
        "repeat_percent": repeat,
        "bounds": bounds,
    }


def _known_bounds(known: list[JsonObject]) -> list[Bound]:
    found = []
    for row in known[:3]:
        found += _row_bounds(row, OFF_OFFSETS if "offsets" in row["case"] else OFF)
    return found


def _row_bounds(row: JsonObject, limit: float) -> list[Bound]:
    held = 100.0 * row["intervals_that_hold"] / row["runs"]
    return [
        Bound(f"{row['case']}: error of the modulus, 9 of 10 runs", row["p90_error_percent"], limit, "%"),
        Bound(f"{row['case']}: intervals that hold the truth", held, HELD, "%", True),
    ]


def _exact_bounds(exact: list[JsonObject]) -> list[Bound]:
    """Return the bounds on how often intervals hold over all runs of the exact law."""
    if not exact:
        return []
    held = 100.0 * sum(row["intervals_that_hold"] for row in exact) / sum(row["runs"] for row in exact)
    return [
        Bound("exact law: intervals that hold the truth", held, HELD, "%", True),
        Bound("exact law: intervals that hold the truth, at most", held, MOST_HELD, "%"),
    ]


def _inclusion_bounds(around: list[JsonObject]) -> list[Bound]:
    found = []
    for row in around:
        reported, elsewhere = (
            100.0 * row[key] / row["runs"] for key in ("reported_over_inclusion", "reported_elsewhere")
        )
        found += _row_bounds(row, OFF_OFFSETS)
        if row["case"].startswith(inclusions.UNKNOWN):
            found.append(Bound(f"{row['case']}: reported over it", reported, REPORTED, "%", True))
        else:
            found.append(Bound(f"{row['case']}: reported over it as if it were unknown", reported, FALSE, "%"))
        found.append(Bound(f"{row['case']}: reported elsewhere", elsewhere, FALSE, "%"))
    return found


def _set_bounds(sets: list[JsonObject]) -> list[Bound]:
    found = []
    for kind, what, limit in (
        ("phantom", "one_modulus", PHANTOM),
        ("phantom", "map", PHANTOM_MAPPED),
        ("meat", "map", MEAT_MAPPED),
    ):
        with_what = "one modulus" if what == "one_modulus" else "a map"
        for row in sets:
            if row["kind"] == kind:
                error = row["errors_percent"]["model"][what]
                found.append(Bound(f"{row['set']}: held-out error with {with_what}", error, limit, "%"))
    return found


def text(found: JsonObject) -> str:
    """Return the figures as tables."""
    lines: list[str] = []
    columns = ["presses by finite elements", "E Pa", "deviation", "median error", "9 of 10", "interval", "hold"]
    if found["known"]:
        table = [columns, *map(_columns, found["known"])]
        lines += [f"Young's modulus of {synthetic.MODULUS:.0f} Pa, {synthetic.USED} presses a run", *aligned(table), ""]
    if found["exact"]:
        table = [["presses by Hertz", *columns[1:]], *map(_columns, found["exact"])]
        lines += ["the law is exact, and every run has places of its own", *aligned(table), ""]
    if found["inclusions"]:
        keys = ("reported_over_inclusion", "reported_elsewhere", "map_pays")
        table = [[*columns, "reported over it", "elsewhere", "map pays"]]
        table += [[*_columns(row), *(f"{row[key]} of {row['runs']}" for key in keys)] for row in found["inclusions"]]
        lines += [f"around an inclusion, {inclusions.USED} places a run", *aligned(table), ""]
    if found["sets"]:
        table = [
            ["set", "presses", "E kPa", *(f"{law} {what}" for law in palpation_sets.LAWS for what in ("%", "map"))]
        ]
        table[0] += ["exponent", "model's", "holds to mm"]
        for row in found["sets"]:
            errors = [
                f"{row['errors_percent'][law][what]:.1f}"
                for law in palpation_sets.LAWS
                for what in ("one_modulus", "map")
            ]
            numbers = [f"{row['exponent']:.2f}", f"{row['model_exponent']:.2f}", f"{row['holds_to_mm']:.1f}"]
            table.append([row["set"], str(row["presses"]), f"{1e-3 * row['modulus_pa']:.1f}", *errors, *numbers])
        lines += [
            "held-out error of the force, median, with one modulus and with a map: the real-time model, Hertz, and a",
            "linearly elastic layer (github.com/vu-arma-dev/robot-palpation-data)",
            *aligned(table),
            "",
            f"{' and '.join(palpation_sets.TWICE)} are the same places: one as a prediction of the other has an error"
            f" of {found['repeat_percent'][1]:.1f} and {found['repeat_percent'][0]:.1f} %",
            "",
        ]
    return "\n".join([*lines, *bound_lines(found["bounds"])])


def _columns(row: JsonObject) -> list[str]:
    """Return the columns that all synthetic cases have."""
    return [
        row["case"],
        f"{row['mean_pa']:.0f}",
        f"{row['deviation_pa']:.0f}",
        *(f"{row[f'{what}_error_percent']:.1f} %" for what in ("median", "p90")),
        f"+- {row['half_width_percent']:.1f} %",
        f"{row['intervals_that_hold']} of {row['runs']}",
    ]
