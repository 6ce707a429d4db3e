"""Benchmark `tissue_sim bench fuzz`: many hostile inputs; each is used, or refused with one line."""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections import Counter
from collections.abc import Sequence
from typing import Any

from tissue_sim import progress
from tissue_sim.bench import rows
from tissue_sim.bench.fuzz.cases import FILES, KINDS, Case, Outcome
from tissue_sim.bench.fuzz.pool import run_cases
from tissue_sim.bench.printing import aligned, emit
from tissue_sim.errors import UserError

MOST = 10_000_000  # cases of a kind
USUAL = 200


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.add_argument(
        "--files", type=int, metavar="N", help=f"files of each kind (default: {USUAL}, if no --scenes is given)"
    )
    parser.add_argument(
        "--scenes", type=int, metavar="N", help=f"scenes of each kind (default: {USUAL}, if no --files is given)"
    )
    parser.add_argument("--seed", type=int, default=1, help="seed of the cases; the same seed gives the same cases")
    parser.add_argument(
        "--kinds", nargs="+", choices=tuple(KINDS), metavar="KIND", help=f"kinds of cases, of {', '.join(KINDS)}"
    )
    parser.add_argument("--case", type=int, metavar="K", help="only this case of each kind, counted from 0")
    parser.add_argument(
        "--from", dest="first", type=int, default=0, metavar="K", help="continue with case K, where a run was stopped"
    )
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="processes")
    parser.add_argument(
        "--json", nargs="?", const="-", metavar="FILE", help="write JSON to a file, or - instead of text"
    )
    parser.add_argument("--check", action="store_true", help="exit with 1 when a case failed")


def run(args: argparse.Namespace) -> int:
    """Run the cases, print what failed with the command that repeats it; return 1 with --check when any did.

    Ctrl-C ends it with what was found so far.
    """
    cases = cases_of(args)
    if args.jobs < 1:
        raise UserError(f"--jobs {args.jobs} is less than 1")
    started = time.perf_counter()
    outcomes = []
    counted: Counter[str] = Counter()
    rows.keep()  # a run that is stopped reports with which case the next one may begin
    with rows.until_stopped(), progress.task("cases", len(cases)) as under_way:
        for outcome in run_cases(cases, args.jobs):
            outcomes.append(outcome)
            counted[outcome.verdict] += 1
            if outcome.verdict == "failed":
                print("\n".join(failure(outcome)), file=sys.stderr if args.json == "-" else sys.stdout, flush=True)
            under_way.advance(1, ", ".join(f"{count} {verdict}" for verdict, count in sorted(counted.items())))
    outcomes.sort(key=lambda outcome: (list(KINDS).index(outcome.case.kind), outcome.case.number))
    found = report(outcomes, args.seed, time.perf_counter() - started)
    emit(found, summary(outcomes, args, found["seconds"]), args.json)
    return int(bool(args.check and counted["failed"]))


def cases_of(args: argparse.Namespace) -> list[Case]:
    """Return the requested cases, most kinds mixed. Raises UserError for numbers out of range."""
    for option, count in (("--files", args.files), ("--scenes", args.scenes)):
        if count is not None and not 1 <= count <= MOST:
            raise UserError(f"{option} {count} is outside 1..{MOST}")
    if args.seed < 0:
        raise UserError(f"--seed {args.seed} is negative")
    for option, number in (("--case", args.case), ("--from", args.first)):
        if number is not None and not 0 <= number < MOST:
            raise UserError(f"{option} {number} is outside 0..{MOST - 1}")
    lacking = [kind for kind in args.kinds or () if KINDS[kind].missing]
    if lacking:
        raise UserError(
            f"no {lacking[0]} to mutate is part of this installation: {KINDS[lacking[0]].needs} is in a checkout"
        )
    usual = USUAL if args.files is None and args.scenes is None else 0
    counts = {kind: (args.files if kind in FILES else args.scenes) or usual for kind in KINDS}
    asked = args.kinds or [kind for kind in KINDS if not KINDS[kind].missing]
    asked = [kind for kind in asked if counts[kind]]
    if not asked:
        raise UserError(f"--kinds {' '.join(args.kinds)} needs {'--scenes' if args.files else '--files'}")
    if args.case is not None:
        return [Case(kind, args.seed, args.case) for kind in asked]
    most = max(counts[kind] for kind in asked)
    if args.first >= most:
        raise UserError(f"--from {args.first} is beyond the last case, {most - 1}")
    numbers = range(args.first, most)
    cases = [Case(kind, args.seed, number) for number in numbers for kind in asked if number < counts[kind]]
    return sorted(cases, key=lambda case: KINDS[case.kind].last)


def repeating(case: Case) -> str:
    """Return the command that repeats a case."""
    return f"tissue_sim bench fuzz --seed {case.seed} --kinds {case.kind} --case {case.number}"


def failure(outcome: Outcome) -> list[str]:
    """Return the lines that report a failure."""
    what = f" [{outcome.what}]" if outcome.what else ""
    return [
        f"FAILED {outcome.case.kind} {outcome.case.number}{what}: {outcome.line}",
        f"  {repeating(outcome.case)}",
    ]


def summary(outcomes: Sequence[Outcome], args: argparse.Namespace, seconds: float) -> str:
    """Return counts by kind; for a single case its outcome."""
    if args.case is not None:
        rows = [o for o in outcomes if o.verdict != "failed"]
        return "\n".join(f"{o.case.kind} {o.case.number} [{o.what}]: {o.verdict}: {o.line}" for o in rows)
    table = [["kind", "cases", "used", "refused", "failed", "slowest s", "most MB"]]
    for kind in dict.fromkeys(outcome.case.kind for outcome in outcomes):
        rows = [outcome for outcome in outcomes if outcome.case.kind == kind]
        counted = Counter(outcome.verdict for outcome in rows)
        counts = [str(counted[verdict]) for verdict in ("used", "refused", "failed")]
        slowest, most = max(o.seconds for o in rows), max(o.megabytes for o in rows)
        table.append([kind, str(len(rows)), *counts, f"{slowest:.1f}", f"{most:.0f}"])
    failed = sum(outcome.verdict == "failed" for outcome in outcomes)
    return "\n".join([*aligned(table), f"{len(outcomes)} cases in {seconds:.0f} s, {failed} failed"])


def report(outcomes: Sequence[Outcome], seed: int, seconds: float) -> dict[str, Any]:
    """Return the outcomes for machines."""
    kinds = dict.fromkeys(outcome.case.kind for outcome in outcomes)
    counts = {kind: Counter(o.verdict for o in outcomes if o.case.kind == kind) for kind in kinds}
    return {
        "seed": seed,
        "seconds": seconds,
        "kinds": {kind: {v: counts[kind][v] for v in ("used", "refused", "failed")} for kind in kinds},
        "failed": [outcome.as_json() for outcome in outcomes if outcome.verdict == "failed"],
        "cases": [outcome.as_json() for outcome in outcomes],
    }
