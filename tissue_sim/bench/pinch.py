"""Benchmark `tissue_sim bench pinch`: two tools squeeze the organ, hold and release it; ticks, cells, force."""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tissue_sim.array_types import Floats
from tissue_sim.bench import pinch_reference, rows
from tissue_sim.bench.arguments import add_shared
from tissue_sim.bench.pinch_tools import Pinch, pairs, pinched
from tissue_sim.bench.printing import Bound, Result, aligned, bound_lines, figure, noise_lines
from tissue_sim.bench.timing import in_one_thread, noise_burst
from tissue_sim.errors import UserError
from tissue_sim.json_types import JsonObject
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.shipped import shipped_organ
from tissue_sim.outputs import write_json

FRACTIONS = (0.2, 0.4, 0.6)  # fractions of the organ's width by which the tools squeeze it
NOT_COMPARED = (
    "forces are not compared: this organ has no table of finite elements; --reference FILE --remake makes one"
)
MOST_TICK, MOST_LEFT = 400.0, 0.1  # us, p99; mm, remaining displacement


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    add_shared(parser, check=True)
    parser.add_argument(
        "--reference",
        metavar="FILE",
        help="file of finite-element forces to compare with; default: those of the kidney of this package",
    )
    parser.add_argument(
        "--remake",
        action="store_true",
        help="first compute the forces of the finite elements and write them there: a quarter of an hour",
    )


def run(args: argparse.Namespace) -> Result:
    """Measure what the arguments ask for."""
    organ = Organ.load(args.organ or shipped_organ())
    # This comes first, because it reports what is missing.
    table = table_of(args, organ)
    reference = None if table is None else pinch_reference.as_json(pinch_reference.measure(organ, table))
    found = as_json(*in_one_thread(measure, organ), reference)
    return Result(found, text(found))


def table_of(args: argparse.Namespace, organ: Organ) -> JsonObject | None:
    """Return the forces of finite elements that are compared with the organ's; None for an organ that has none.

    Raises UserError for a file that is not such a table, or is another organ's, and as Body does.
    """
    shipped = pinch_reference.stored() if args.organ is None else None
    path = Path(args.reference) if args.reference else shipped
    if args.remake:
        if path is None:
            raise UserError("--remake writes a file; name it with --reference FILE")
        if path.suffix == ".npz":
            raise UserError(f"--reference {path} would overwrite an organ; name a file like pinch.json")
        write_json(path, pinch_reference.make(organ))
    return None if path is None else pinch_reference.read(path, organ)


def measure(organ: Organ) -> tuple[list[Pinch], Floats]:
    """Return every pair of tools on every axis by every fraction, and seconds of a fixed loop, in one thread."""
    with tempfile.TemporaryDirectory() as folder:
        todo = [(*pair, axis, fraction) for pair in pairs(Path(folder)) for axis in range(3) for fraction in FRACTIONS]
        found = []
        with rows.until_stopped():
            for one in rows.each(todo, "pinches"):
                found.append(pinched(organ, *one))
                rows.report(f"{one[0]}, {'xyz'[one[2]]}, {100.0 * one[3]:g} %", f"{found[-1].force:.2f} N")
        return found, noise_burst(2000)


def as_json(pinches: Sequence[Pinch], bursts: Floats, reference: JsonObject | None = None) -> JsonObject:
    """Return all figures and bounds; bursts: s of a fixed loop, in the same run; reference: pinch_reference.as_json."""
    table: list[JsonObject] = [
        {
            "tools": one.tools,
            "axis": "xyz"[one.axis],
            "share_percent": 100.0 * one.fraction,
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
    gentle = [row for row in table if row["share_percent"] < 50.0]
    bounds = [
        Bound(
            "inverted cells, held at 20 and 40 %",
            max((row["held_turned"] for row in gentle), default=None),
            0.0,
            "cells",
        ),
        Bound("inverted cells long after", max((row["left_turned"] for row in table), default=None), 0.0, "cells"),
        Bound("remaining deformation", max((row["left_mm"] for row in table), default=None), MOST_LEFT, "mm"),
        Bound("tick, p99 of the worst", max((row["p99_us"] for row in table), default=None), MOST_TICK, "us"),
    ]
    stated = [bound.as_json() for bound in bounds]
    loop = float(np.median(bursts))
    noise = float(np.percentile(bursts, 99)) / loop
    found = {"rows": table, "bounds": stated, "fixed_loop_us": 1e6 * loop, "noise": noise}
    if reference is not None:
        stated.append(reference["bound"])
        found["reference"] = reference["rows"]
    return found


def text(found: JsonObject) -> str:
    """Return the figures as a table."""
    names = ["tools", "axis", "%", "tick p50", "p99 us", "substeps", "turned", "held", "least J", "after", "faults"]
    table = [[*names, "force N"]]
    for row in found["rows"]:
        numbers = [figure(row[key]) for key in ("share_percent", "p50_us", "p99_us")]
        counts = [str(row[key]) for key in ("most_substeps", "most_turned", "held_turned")]
        ends = [f"{row['least_volume']:.2f}", str(row["left_turned"]), str(row["faults"]), f"{row['force_n']:.2f}"]
        table.append([row["tools"], row["axis"], *numbers, *counts, *ends])
    lines = [
        "compressed by a fraction of the width in 0.8 s, held for 0.4 s, released in 0.3 s; processor time of one"
        " thread",
        f"a fixed loop takes {figure(found['fixed_loop_us'])} us",
        "",
        *aligned(table, 2),
        "",
        *(pinch_reference.lines(found["reference"]) if "reference" in found else [NOT_COMPARED]),
        "",
        *bound_lines(found["bounds"]),
        *noise_lines(found["noise"]),
    ]
    return "\n".join(lines)
