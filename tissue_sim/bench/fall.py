"""Benchmark `tissue_sim bench fall`: loads applied suddenly, against the same ones raised as a hand does.

Under a sudden load the organ overshoots its equilibrium. Where that inverts tissue, a dent may remain that the load
alone doesn't make.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tissue_sim.array_types import Floats
from tissue_sim.bench import rows
from tissue_sim.bench.arguments import add_shared
from tissue_sim.bench.printing import Bound, Result, aligned, bound_lines
from tissue_sim.bench.timing import in_one_thread
from tissue_sim.calibration.cases import held_out_cases, tractions
from tissue_sim.calibration.evaluation import LONGEST, RAMP, TOLERANCE
from tissue_sim.errors import UserError
from tissue_sim.json_types import JsonObject
from tissue_sim.model.elasticity.cells import swelling
from tissue_sim.model.simulation import Simulation
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.shipped import shipped_organ

TRACTIONS = (0.2, 0.4, 0.6, 0.8)  # of Young's modulus, the largest at any node
JUDGED = 0.4  # traction up to which nothing may remain
SHARP = 3  # every third load is on a node and its neighbours, the others are bumps
MOST_OFF = 1.0  # %


class SuddenLoad(NamedTuple):
    """Results of one load, raised and applied suddenly."""

    traction: float  # of Young's modulus
    kind: str
    newton: float
    deepest: float  # m, of the raised one
    off: float  # relative L2 of the settled surface, raised and let fall
    settled: bool  # both
    turned: int  # inverted cells that only the fall has left
    least: float  # volume of a cell over that at rest, after the fall
    faults: int  # of the fall


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    add_shared(parser, check=True)
    parser.add_argument(
        "--loads", type=int, default=30, help="number of loads for each traction, distributed over the surface"
    )


def run(args: argparse.Namespace) -> Result:
    """Measure what the arguments ask for."""
    if not SHARP <= args.loads <= 1000:
        raise UserError(f"--loads {args.loads} is outside {SHARP}..1000")
    organ = Organ.load(args.organ or shipped_organ())
    found = as_json(in_one_thread(measure, organ, args.loads))
    return Result(found, text(organ, found))


def measure(organ: Organ, count: int, fractions: Sequence[float] = TRACTIONS) -> list[SuddenLoad]:
    """Return `count` loads for each fraction of Young's modulus. Raises UserError without enough free nodes."""
    sharp = count // SHARP
    cases = held_out_cases(organ, count - sharp, sharp)
    cases = cases.scaled(organ.youngs_modulus / tractions(cases.force, organ))
    simulation = Simulation(organ)
    todo = [(fraction, case) for fraction in fractions for case in range(count)]
    found = []
    with rows.until_stopped():
        for fraction, case in rows.each(todo, "loads"):
            found.append(fallen(simulation, fraction, cases.kind[case], fraction * cases.force[case]))
            rows.report(f"{fraction:g} E, {cases.kind[case]}", f"difference {100.0 * found[-1].off:.2f} %")
    return found


def fallen(simulation: Simulation, fraction: float, kind: str, force: Floats) -> SuddenLoad:
    """Return the results of one load (n_surface, 3) N."""
    raised, rose = simulation.settle(force, TOLERANCE, LONGEST, RAMP)
    turned = swelling(simulation.model, simulation.positions) <= 0.0
    faults = int(simulation.state.count.faults)
    dropped, fell = simulation.settle(force, TOLERANCE, LONGEST)
    volume = swelling(simulation.model, simulation.positions)
    return SuddenLoad(
        traction=fraction,
        kind=kind,
        newton=float(np.linalg.norm(force, axis=1).sum()),
        deepest=float(np.linalg.norm(raised, axis=1).max()),
        off=float(np.linalg.norm(dropped - raised) / np.linalg.norm(raised)),
        settled=rose and fell,
        turned=int(np.count_nonzero((volume <= 0.0) & ~turned)),
        least=float(volume.min(initial=1.0)),
        faults=int(simulation.state.count.faults) - faults,
    )


def as_json(found: Sequence[SuddenLoad]) -> JsonObject:
    """Return all figures, and the bounds on loads of at most JUDGED."""
    judged = [one for one in found if one.traction <= JUDGED]
    up_to = f"up to {JUDGED:g} E"
    bounds = [
        Bound(f"difference from the raised load, {up_to}", 100.0 * max(one.off for one in judged), MOST_OFF, "%"),
        Bound(f"inverted cells, {up_to}", max(one.turned for one in judged), 0.0, "cells"),
        Bound(
            f"loads that converge, {up_to}", 100.0 * float(np.mean([one.settled for one in judged])), 100.0, "%", True
        ),
    ]
    return {"loads": [one._asdict() for one in found], "bounds": [bound.as_json() for bound in bounds]}


def text(organ: Organ, found: JsonObject) -> str:
    """Return the figures as a table, a row for each traction."""
    table = [
        ["traction / E", "loads", "settled", "deepest mm", "difference % worst", "inverted", "least volume", "faults"]
    ]
    for fraction in dict.fromkeys(one["traction"] for one in found["loads"]):
        some = [one for one in found["loads"] if one["traction"] == fraction]
        deep, off = 1e3 * max(one["deepest"] for one in some), 100.0 * max(one["off"] for one in some)
        counts = [str(len(some)), str(sum(one["settled"] for one in some))]
        turned, faults = max(one["turned"] for one in some), sum(one["faults"] for one in some)
        least = f"{min(one['least'] for one in some):.2f}"
        table.append([f"{fraction:g}", *counts, f"{deep:.1f}", f"{off:.2f}", str(turned), least, str(faults)])
    lines = [f"organ '{organ.name}': suddenly applied loads, against the same ones raised within {RAMP:g} s"]
    return "\n".join([*lines, *aligned(table), "", *bound_lines(found["bounds"])])
