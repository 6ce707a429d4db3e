"""`tissue_sim bench cut`: time of a cut and its parts, and of the ticks before it, while it is made, and after it."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from tissue_sim.array_types import Floats
from tissue_sim.bench import rows
from tissue_sim.bench.cutting.cuts import CUTS, OPENING, Cut, Place, loads_of, placed
from tissue_sim.bench.cutting.organs import kidney
from tissue_sim.bench.printing import Bound, aligned, bound_lines, figure, noise_lines
from tissue_sim.bench.timing import Ticks, describe, noise_burst
from tissue_sim.model.cutting.crossing import crossing_among
from tissue_sim.model.cutting.cut import CutOrgan, cut_again, not_cut
from tissue_sim.model.cutting.cut_surface import cut_surface
from tissue_sim.model.cutting.masses import shared_masses
from tissue_sim.model.cutting.parts import CutCells, together
from tissue_sim.model.cutting.sheet import sheet_of
from tissue_sim.model.simulation import Simulation
from tissue_sim.organ.organ import Organ

REPEATS = 3  # of every part of a cut, of which the median is taken
TICKS = 2000  # before and after
FORCE = 0.1  # N on each lip while ticks are timed, which rises and falls five times a second
MOST_TICK, MOST_P99, LEAST_STEP = 1000.0, 250.0, 95.0  # us; us; % of the critical step of the uncut organ
PEER = (
    "for comparison, Sase, Fukuhara, Tsujita & Konno 2015 (ROBOMECH Journal 2, 17): a time step of blunt dissection",
    "takes less than 20 ms on a graphics processor, for 4,807 nodes and 19,600 elements",
)


class During(NamedTuple):
    """Ticks while a cut is made, and what came of it."""

    seconds: Floats  # (t,) of each tick
    opened: Simulation
    taken_up: float  # s in which the state is carried over, between two ticks


class Timed(NamedTuple):
    """Times of one cut, s, and the sizes of the organ before and after it."""

    cut: Cut
    total: float  # Simulation.cut
    sheet: float  # the polyline and the surface
    topology: float  # divided cells and virtual nodes
    masses: float
    surface: float
    before: Floats  # (t,) of each tick
    during: Floats
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
            rows.tell(cut.name, f"{1e3 * found[-1].total:.0f} ms")
    return found, noise_burst(2000)


def timed(organ: Organ, cut: Cut) -> Timed:
    """Time a cut, its parts, and ticks under a load that pulls its lips apart.

    Parameters
    ----------
    organ : Organ
        The organ.
    cut : Cut
        The cut.
    """
    place = placed(organ, cut)
    parts = _parts(organ, place)
    loads = loads_of(organ, place)
    force = FORCE * loads.force[loads.names.index(OPENING)]
    nodes = np.flatnonzero(force.any(axis=1))
    simulation = Simulation(organ)
    before, substeps_before = _ticks(simulation, force, TICKS)
    made = during(simulation, place, force)
    first = float(Ticks(made.opened, nodes, force[nodes])(1)[0])
    after, substeps_after = _ticks(made.opened, force, TICKS)
    report = made.opened.cuts[-1]
    return Timed(
        cut=cut,
        **parts,
        before=before,
        during=made.seconds,
        taken_up=made.taken_up,
        first=first,
        after=after,
        cells=(len(organ.cell_nodes), len(made.opened.organ.cell_nodes)),
        nodes=(organ.n_nodes, made.opened.organ.n_nodes),
        substeps=(substeps_before, substeps_after),
        critical_step=(report.critical_step_before, report.critical_step_after),
    )


def during(simulation: Simulation, place: Place, force: Floats) -> During:
    """Make a cut while the organ goes on ticking in this thread, under a load.

    Parameters
    ----------
    simulation : Simulation
        The organ before the cut.
    place : Place
        The cut.
    force : Floats, shape (n_surface, 3), N
        The load.
    """
    nodes = np.flatnonzero(force.any(axis=1))
    ticks, parts, made = Ticks(simulation, nodes, force[nodes]), [], []

    def work() -> None:
        sheet = place.sheet
        made.append(simulation.prepared_cut(sheet.polyline, sheet.direction, sheet.depth))

    thread = threading.Thread(target=work)
    thread.start()
    while thread.is_alive():
        parts.append(ticks(20))
    thread.join()
    (opened,) = made
    start = time.thread_time()
    opened.continue_from(simulation)
    return During(np.concatenate(parts), opened, time.thread_time() - start)


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
    sheet, before = place.sheet, not_cut(organ)
    simulation = Simulation(organ)

    def topology() -> list[CutCells]:
        return together(organ, [crossing_among(organ.rest_positions, organ.cell_nodes, sheet)], organ.fixed)

    divided = topology()
    after: CutOrgan = cut_again(before, sheet)
    return {
        "total": _took(lambda: opened_by(simulation, place)),
        "sheet": _took(lambda: sheet_of(organ, sheet.polyline, sheet.direction, sheet.depth)),
        "topology": _took(topology),
        "masses": _took(lambda: shared_masses(organ, after.organ, before.frequency)),
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


def as_json(found: list[Timed], bursts: Floats) -> dict[str, Any]:
    """Return all figures and bounds.

    Parameters
    ----------
    found : list[Timed]
        The times.
    bursts : Floats, shape (k,), s
        Times of a fixed loop, in the same run.

    Returns
    -------
    dict[str, Any]
        The figures by name.
    """
    table = [_row(one) for one in found]

    def worst(key: str) -> float | None:
        return max((row[key] for row in table), default=None)

    steps = [100.0 * row["critical_step_after_us"] / row["critical_step_before_us"] for row in table]
    bounds = [
        Bound("longest tick while a cut is made, and when it is taken up", worst("longest_us"), MOST_TICK, "us"),
        Bound("ticks while a cut is made, p99", worst("during_p99_us"), MOST_P99, "us"),
        Bound("critical step after a cut", min(steps, default=None), LEAST_STEP, "% of that before", least=True),
    ]
    loop = float(np.median(bursts))
    return {
        "rows": table,
        "bounds": [bound.as_json() for bound in bounds],
        "fixed_loop_us": 1e6 * loop,
        "noise": float(np.percentile(bursts, 99)) / loop,
    }


def _row(one: Timed) -> dict[str, Any]:
    """Return the figures of a cut."""
    row: dict[str, Any] = {"cut": one.cut.name}
    for name in ("total", "sheet", "topology", "masses", "surface"):
        row[f"{name}_ms"] = 1e3 * getattr(one, name)
    for name in ("before", "during", "after"):
        timing = describe(getattr(one, name))
        row[f"{name}_p50_us"], row[f"{name}_p99_us"] = 1e6 * timing.median, 1e6 * timing.p99
    row["rest_ms"] = row["total_ms"] - sum(row[f"{name}_ms"] for name in ("sheet", "topology", "masses", "surface"))
    row["taken_up_us"], row["first_us"] = 1e6 * one.taken_up, 1e6 * one.first
    row["longest_us"] = 1e6 * max(float(one.during.max()), one.taken_up + one.first)
    for name in ("cells", "nodes", "substeps"):
        row[f"{name}_before"], row[f"{name}_after"] = getattr(one, name)
    row["critical_step_before_us"], row["critical_step_after_us"] = (1e6 * step for step in one.critical_step)
    return row


def text(found: dict[str, Any]) -> str:
    """Return the figures as tables.

    Parameters
    ----------
    found : dict[str, Any]
        The figures.

    Returns
    -------
    str
        The text.
    """
    parts = ("total", "sheet", "topology", "masses", "surface", "rest")
    cuts = [["cut, mm", *(f"{name} ms" for name in parts), "cells", "nodes", "critical step us"]]
    ticks = [
        ["ticks", "before p50", "p99 us", "during p50", "p99", "taken up", "first", "after p50", "p99", "substeps"]
    ]
    for row in found["rows"]:
        sizes = [f"{row[f'{name}_before']} to {row[f'{name}_after']}" for name in ("cells", "nodes")]
        step = f"{row['critical_step_before_us']:.0f} to {row['critical_step_after_us']:.0f}"
        cuts.append([row["cut"], *(figure(row[f"{name}_ms"]) for name in parts), *sizes, step])
        names = ("before_p50", "before_p99", "during_p50", "during_p99", "taken_up", "first", "after_p50", "after_p99")
        substeps = f"{row['substeps_before']} to {row['substeps_after']}"
        ticks.append([row["cut"], *(figure(row[f"{name}_us"]) for name in names), substeps])
    lines = [
        "parts of a cut: the polyline on the surface, divided cells and virtual nodes, shared masses, the new surface;",
        "the rest is the fastest mode of the organ before and after, and the assembly of the model; processor time of",
        "one thread; the cut is prepared beside the ticks, in another thread, and taken up between two of them",
        f"a fixed loop takes {figure(found['fixed_loop_us'])} us",
        "",
        *aligned(cuts),
        "",
        *aligned(ticks),
        "",
        *PEER,
        "",
        *bound_lines(found["bounds"]),
        *noise_lines(found["noise"]),
    ]
    return "\n".join(lines)
