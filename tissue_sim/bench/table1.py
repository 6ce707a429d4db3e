"""Benchmark `tissue_sim bench table1`: the paper's Table 1 and Figure 6 on a 994-point organ with 48 medial atoms."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tissue_sim import progress
from tissue_sim.array_types import Floats
from tissue_sim.bench import rows
from tissue_sim.bench.arguments import AS_BUILT_ORGAN, add_shared
from tissue_sim.bench.organs import spread_nodes
from tissue_sim.bench.printing import Result, aligned, noise_lines
from tissue_sim.bench.timing import Burst, Phase, Ticks, Timing, in_one_thread, interleave, noise_burst
from tissue_sim.errors import UserError
from tissue_sim.json_types import JsonObject
from tissue_sim.model.simulation import Simulation
from tissue_sim.organ.normals import surface_normals
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.shipped import AS_BUILT, shipped_organ

if TYPE_CHECKING:
    from tissue_sim.bench.figure6 import Panel

GLOBAL_POINTS = 10


class Variant(NamedTuple):
    """Column of the table: the model, the local region, the paper's figures (5,) ms per update, where there are any."""

    name: str
    model: str
    local_region: str
    paper: tuple[float, ...] | None


class Force(NamedTuple):
    """Row of the table: the paper's name of the force, its magnitude without unit, and the number of points."""

    name: str
    magnitude: float
    points: int


WHOLE = "Hybrid MS"
VARIANTS = (
    Variant("Surface MS", "surface", "off", (0.531, 0.547, 0.546, 0.563, 1.891)),
    Variant("Volume MS", "volume", "off", None),
    Variant(WHOLE, "hybrid", "off", (0.766, 0.829, 0.812, 0.859, 11.187)),
    Variant("Hybrid LR frozen", "hybrid", "frozen", (0.750, 0.765, 0.782, 0.797, 7.938)),
    Variant("Hybrid LR modal", "hybrid", "modal", None),
)
FORCES = (
    *(Force(f"LF({size})", size, 1) for size in (25, 50, 75, 100)),
    Force("GF(500)", 500, GLOBAL_POINTS),
)


class Entry(NamedTuple):
    """Results of one variant under one force: time of an update, and its equilibrium against the whole hybrid model."""

    timing: Timing
    substeps: int
    active: int  # nodes that move by their springs
    settled: bool
    largest: float  # m
    deviation: float  # relative L2 of the surface displacement against the whole hybrid model's
    displacement: Floats  # (n_surface, 3) m


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    add_shared(parser, organ=AS_BUILT_ORGAN, out="write Figure 6 there, as PNG")
    parser.add_argument("--unit", type=float, default=2.0, help="mN that represent one unit of the paper's forces")
    parser.add_argument(
        "--quick", action="store_true", help="shorter measurements, and 2 s instead of 5 s to reach equilibrium"
    )


def run(args: argparse.Namespace) -> Result:
    """Measure what the arguments ask for. Raises UserError for a unit out of range."""
    if not 1e-3 <= args.unit <= 1e3:
        raise UserError(f"--unit {args.unit:g} mN is outside 0.001..1000")
    organ = Organ.load(args.organ or shipped_organ(AS_BUILT))
    unit = 1e-3 * args.unit
    cells, noise = in_one_thread(measure, organ, unit, args.quick)
    found = as_json(organ, unit, cells, noise)
    if not args.out or rows.stopped():
        return Result(found, text(found))
    from tissue_sim.bench.figure6 import pictures_of

    return Result(found, text(found), pictures_of(organ, panels(organ, unit, cells)))


def load(organ: Organ, force: Force, unit: float) -> tuple[NDArray[np.int64], Floats]:
    """Return nodes (k,) and forces (k, 3) N: the middle of the broad side, or points spread over that side.

    All push inward as in the middle; the magnitude is that of all points together.
    """
    nodes = spread_nodes(organ, force.points)
    inward = -surface_normals(organ.surface_positions, organ.surface_triangles)[nodes[0]]
    return nodes, np.tile(unit * force.magnitude / force.points * inward, (force.points, 1))


def measure(organ: Organ, unit: float, quick: bool) -> tuple[dict[str, dict[str, Entry]], Timing]:
    """Return every variant under every force, by names of force and variant, and the timing of the fixed loop."""
    simulations = [Simulation(organ, model=variant.model, local_region=variant.local_region) for variant in VARIANTS]
    bursts: dict[str, Burst] = {"noise": noise_burst}
    settled: dict[tuple[str, str], tuple[Floats, bool, int, int]] = {}
    jobs = [
        (force, variant, simulation)
        for force in FORCES
        for variant, simulation in zip(VARIANTS, simulations, strict=True)
    ]
    for force, variant, simulation in progress.steps(jobs, "settling"):
        nodes, forces = load(organ, force, unit)
        whole = np.zeros((organ.n_surface, 3))
        whole[nodes] = forces
        displacement, done = simulation.settle(whole, longest=2.0 if quick else 5.0)
        status = simulation.state.status
        settled[force.name, variant.name] = displacement, done, int(status.substeps), int(status.active)
        bursts[f"{force.name} {variant.name}"] = Ticks(simulation, nodes, forces, steady=True)
    timings = interleave(Phase(bursts, 0.2 if quick else 1.0, "table 1"))
    cells: dict[str, dict[str, Entry]] = {}
    for (row, column), (displacement, done, substeps, active) in settled.items():
        whole = settled[row, WHOLE][0]
        cells.setdefault(row, {})[column] = Entry(
            timings[f"{row} {column}"],
            substeps,
            active,
            done,
            float(np.linalg.norm(displacement, axis=1).max()),
            float(np.linalg.norm(displacement - whole) / np.linalg.norm(whole)),
            displacement,
        )
    return cells, timings["noise"]


def as_json(organ: Organ, unit: float, cells: dict[str, dict[str, Entry]], noise: Timing) -> JsonObject:
    """Return the table for machines; units stand in the names."""
    rows = []
    for index, force in enumerate(FORCES):
        for variant in VARIANTS:
            cell = cells[force.name][variant.name]
            rows.append(
                {
                    "force": force.name,
                    "force_n": unit * force.magnitude,
                    "points": force.points,
                    "variant": variant.name,
                    "median_ms": 1e3 * cell.timing.median,
                    "p99_ms": 1e3 * cell.timing.p99,
                    "samples": cell.timing.samples,
                    "paper_ms": variant.paper[index] if variant.paper else None,
                    "substeps": cell.substeps,
                    "moving_nodes": cell.active,
                    "settled": cell.settled,
                    "largest_mm": 1e3 * cell.largest,
                    "deviation": cell.deviation,
                }
            )
    return {
        "benchmark": "table1",
        "organ": organ.name,
        "surface_points": organ.n_surface,
        "medial_atoms": organ.n_atoms,
        "interior_atoms": organ.n_interior,
        "unit_n": unit,
        "noise": noise.p99 / noise.median,
        "rows": rows,
    }


def text(found: JsonObject) -> str:
    """Return the table to be printed."""
    lines = [
        f"Table 1 of the paper on '{found['organ']}': {found['surface_points']} surface points,"
        f" {found['medial_atoms']} medial atoms, {found['interior_atoms']} interior atoms",
        f"one unit of force is {1e3 * found['unit_n']:g} mN: LF(100) is {100 * found['unit_n']:g} N on one point,"
        f" GF(500) {500 * found['unit_n']:g} N distributed over {GLOBAL_POINTS} points",
        "an update is one tick of 1 ms from inputs to positions, including every substep, the guard and the"
        " wrenches, but not drawing; the paper's (2006, Pentium 4) grows with the force",
        "",
    ]
    table = [["force", "model", "ms/update", "p99", "paper", "paper/ours"]]
    table[0] += ["substeps", "nodes", "settled", "largest mm", "error"]
    for row in found["rows"]:
        paper = row["paper_ms"]
        table.append(
            [
                row["force"],
                row["variant"],
                f"{row['median_ms']:.3f}",
                f"{row['p99_ms']:.3f}",
                "-" if paper is None else f"{paper:.3f}",
                "-" if paper is None else f"{paper / row['median_ms']:.1f}",
                str(row["substeps"]),
                str(row["moving_nodes"]),
                "yes" if row["settled"] else "no",
                f"{row['largest_mm']:.2f}",
                "0" if row["variant"] == WHOLE else f"{100.0 * row['deviation']:.1f} %",
            ]
        )
    lines += aligned(table, left=2)
    lines.append("")
    lines.append("error: relative L2 of the equilibrium surface displacement against Hybrid MS under the same force")
    return "\n".join(lines + noise_lines(found["noise"]))


def panels(organ: Organ, unit: float, cells: dict[str, dict[str, Entry]], *, with_nip: bool = True) -> list[Panel]:
    """Return the panels of Figure 6: nip and release, global deformation of the hybrid and of the surface model."""
    from tissue_sim.bench.figure6 import NO_JAWS, Panel, pinch_and_release

    force = FORCES[-1]
    nodes, forces = load(organ, force, unit)
    found = list(pinch_and_release(organ)) if with_nip else []
    for letter, name, column in (("C", "global", WHOLE), ("D", "surface_global", "Surface MS")):
        cell = cells[force.name][column]
        ending = "" if cell.settled else ", not converged"
        title = f"{letter}  {column}: {unit * force.magnitude:g} N on {force.points} points{ending}"
        found.append(Panel(name, title, organ.surface_positions + cell.displacement, NO_JAWS, nodes, forces))
    return found
