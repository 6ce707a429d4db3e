"""Processor time of a cut and its parts, and of the ticks before and after it."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from tissue_sim.array_types import Floats
from tissue_sim.bench import rows
from tissue_sim.bench.cutting.cuts import CUTS, OPENING, Cut, Place, loads_of, placed
from tissue_sim.bench.cutting.organs import kidney
from tissue_sim.bench.printing import Bound, aligned, figure
from tissue_sim.bench.timing import Ticks, describe, noise_burst
from tissue_sim.json_types import JsonObject
from tissue_sim.model.cutting.crossing import crossing_among
from tissue_sim.model.cutting.cut import CutOrgan, cut_again, without_cuts
from tissue_sim.model.cutting.cut_surface import cut_surface
from tissue_sim.model.cutting.masses import distributed_masses
from tissue_sim.model.cutting.parts import CutCells, divided_by_cuts
from tissue_sim.model.cutting.sheet import sheet_of
from tissue_sim.model.simulation import Simulation
from tissue_sim.organ.organ import Organ

REPEATS = 3  # of every part of a cut, of which the median is taken
TICKS = 2000  # before and after
FORCE = 0.1  # N on each lip while ticks are timed, which rises and falls five times a second
LEAST_STEP = 95.0  # % of the critical step of the uncut organ


class Timed(NamedTuple):
    """Times of one cut, s, and the sizes of the organ before and after it."""

    cut: Cut
    total: float  # Simulation.cut
    sheet: float  # the polyline and the surface
    topology: float  # divided cells and virtual nodes
    masses: float
    surface: float
    before: Floats  # (t,) of each tick
    taken_up: float  # in which the state is carried over, between two ticks
    first: float  # of the first tick after it
    after: Floats
    cells: tuple[int, int]
    nodes: tuple[int, int]
    substeps: tuple[int, int]  # most in a tick
    critical_step: tuple[float, float]  # s


def measure() -> tuple[list[Timed], Floats]:
    """Return the times of the kidney's cuts, and seconds of a fixed loop, in one thread."""
    organ = kidney()
    found: list[Timed] = []
    with rows.until_stopped():
        for cut in rows.each([one for one in CUTS if one.organ == "kidney"], "cuts"):
            found.append(timed(organ, cut))
            rows.report(cut.name, f"{1e3 * found[-1].total:.0f} ms")
    return found, noise_burst(2000)


def timed(organ: Organ, cut: Cut) -> Timed:
    """Time a cut, its parts, and ticks under a load that pulls its lips apart."""
    place = placed(organ, cut)
    parts = _parts(organ, place)
    loads = loads_of(organ, place)
    force = FORCE * loads.force[loads.names.index(OPENING)]
    nodes = np.flatnonzero(force.any(axis=1))
    simulation = Simulation(organ)
    before, substeps_before = _ticks(simulation, force, TICKS)
    opened = simulation.prepared_cut(place.sheet.polyline, place.sheet.direction, place.sheet.depth)
    taken_up = _taken_up(simulation, opened)
    first = float(Ticks(opened, nodes, force[nodes])(1)[0])
    after, substeps_after = _ticks(opened, force, TICKS)
    report = opened.cuts[-1]
    return Timed(
        cut=cut,
        **parts,
        before=before,
        taken_up=taken_up,
        first=first,
        after=after,
        cells=(len(organ.cell_nodes), len(opened.organ.cell_nodes)),
        nodes=(organ.n_nodes, opened.organ.n_nodes),
        substeps=(substeps_before, substeps_after),
        critical_step=(report.critical_step_before, report.critical_step_after),
    )


def _taken_up(simulation: Simulation, opened: Simulation) -> float:
    """Return the processor time, s, in which a prepared simulation takes over the state of the one before."""
    start = time.thread_time()
    opened.continue_from(simulation)
    return time.thread_time() - start


def opened_by(simulation: Simulation, place: Place) -> Simulation:
    """Return a simulation with a cut."""
    return simulation.cut(place.sheet.polyline, place.sheet.direction, place.sheet.depth)


def _ticks(simulation: Simulation, force: Floats, count: int) -> tuple[Floats, int]:
    """Return the times of ticks under a load that rises and falls, and the most substeps of one."""
    nodes = np.flatnonzero(force.any(axis=1))
    ticks = Ticks(simulation, nodes, force[nodes])
    ticks.swing()
    times, most = [], 0
    for _ in range(count // 100):
        times.append(ticks(100))
        most = max(most, int(simulation.state.status.substeps))
    return np.concatenate(times), most


def _parts(organ: Organ, place: Place) -> dict[str, float]:
    """Return the median times of a cut and its parts, s."""
    sheet, before = place.sheet, without_cuts(organ)
    simulation = Simulation(organ)

    def topology() -> list[CutCells]:
        return divided_by_cuts(organ, [crossing_among(organ.rest_positions, organ.cell_nodes, sheet)], organ.fixed)

    divided = topology()
    after: CutOrgan = cut_again(before, sheet)
    return {
        "total": _took(lambda: opened_by(simulation, place)),
        "sheet": _took(lambda: sheet_of(organ, sheet.polyline, sheet.direction, sheet.depth)),
        "topology": _took(topology),
        "masses": _took(lambda: distributed_masses(organ, after.organ, before.frequency)),
        "surface": _took(lambda: cut_surface(organ, divided)),
    }


def _took(work: Callable[[], object]) -> float:
    """Return the median time of a piece of work, s."""
    times = []
    for _ in range(REPEATS):
        start = time.thread_time()
        work()
        times.append(time.thread_time() - start)
    return float(np.median(times))


# telling -------------------------------------------------------------------------------------------


def as_json(found: list[Timed], bursts: Floats) -> JsonObject:
    """Return all figures and bounds. bursts (k,) s: times of a fixed loop, in the same run."""
    table = [_row(one) for one in found]

    steps = [100.0 * row["critical_step_after_us"] / row["critical_step_before_us"] for row in table]
    bounds = [
        Bound("critical step after a cut", min(steps, default=None), LEAST_STEP, "% of that before", least=True),
    ]
    loop = float(np.median(bursts))
    return {
        "rows": table,
        "bounds": [bound.as_json() for bound in bounds],
        "fixed_loop_us": 1e6 * loop,
        "noise": float(np.percentile(bursts, 99)) / loop,
    }


def _row(one: Timed) -> JsonObject:
    """Return the figures of a cut."""
    row: JsonObject = {"cut": one.cut.name}
    for name in ("total", "sheet", "topology", "masses", "surface"):
        row[f"{name}_ms"] = 1e3 * getattr(one, name)
    for name in ("before", "after"):
        timing = describe(getattr(one, name))
        row[f"{name}_p50_us"], row[f"{name}_p99_us"] = 1e6 * timing.median, 1e6 * timing.p99
    row["rest_ms"] = row["total_ms"] - sum(row[f"{name}_ms"] for name in ("sheet", "topology", "masses", "surface"))
    row["taken_up_us"], row["first_us"] = 1e6 * one.taken_up, 1e6 * one.first
    for name in ("cells", "nodes", "substeps"):
        row[f"{name}_before"], row[f"{name}_after"] = getattr(one, name)
    row["critical_step_before_us"], row["critical_step_after_us"] = (1e6 * step for step in one.critical_step)
    return row


def text(found: JsonObject) -> list[str]:
    """Return the figures as lines of tables."""
    parts = ("total", "sheet", "topology", "masses", "surface", "rest")
    cuts = [["cut, mm", *(f"{name} ms" for name in parts), "cells", "nodes", "critical step us"]]
    ticks = [["ticks", "before p50", "p99 us", "taken up", "first", "after p50", "p99", "substeps"]]
    for row in found["rows"]:
        sizes = [f"{row[f'{name}_before']} to {row[f'{name}_after']}" for name in ("cells", "nodes")]
        step = f"{row['critical_step_before_us']:.0f} to {row['critical_step_after_us']:.0f}"
        cuts.append([row["cut"], *(figure(row[f"{name}_ms"]) for name in parts), *sizes, step])
        names = ("before_p50", "before_p99", "taken_up", "first", "after_p50", "after_p99")
        substeps = f"{row['substeps_before']} to {row['substeps_after']}"
        ticks.append([row["cut"], *(figure(row[f"{name}_us"]) for name in names), substeps])
    return [
        "parts of a cut: the polyline on the surface, divided cells and virtual nodes, shared masses, the new surface;",
        "the rest is the fastest mode of the organ before and after, and the assembly of the model; ticks under forces",
        "on both lips, and how long the state is carried over; processor time of one thread",
        f"a fixed loop takes {figure(found['fixed_loop_us'])} us",
        "",
        *aligned(cuts),
        "",
        *aligned(ticks),
    ]
