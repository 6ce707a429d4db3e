"""Benchmark `tissue_sim bench region`: errors of the local regions against the whole model, by place and size."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from itertools import islice
from typing import NamedTuple

import numpy as np
from scipy.sparse.linalg import splu

from tissue_sim import progress
from tissue_sim.array_types import Floats
from tissue_sim.bench import rows
from tissue_sim.bench.arguments import add_shared
from tissue_sim.bench.organs import PATCH_NODES, bean, patch, patch_load
from tissue_sim.bench.printing import Bound, Result, aligned, bound_lines, figure
from tissue_sim.bench.timing import Phase, Ticks, Timing, interleave
from tissue_sim.calibration.stiffness import Settings, prepared
from tissue_sim.errors import UserError
from tissue_sim.json_types import JsonObject
from tissue_sim.model.data.settings import LocalRegion
from tissue_sim.model.data.state import Region
from tissue_sim.model.elasticity.hop_distances import hop_table
from tissue_sim.model.elasticity.modes import free_axes, stiffness_matrix
from tissue_sim.model.regions.region_tables import moves_whole
from tissue_sim.model.simulation import Simulation
from tissue_sim.organ.normals import surface_normals
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.shipped import shipped_organ

SMALL = 0.02  # N, under which the whole model is nearly linear
DENTS = (3e-3, 6e-3)  # m
FAR_HOPS = 5  # from held nodes: nearer than that hardly anything moves
WHOLE_LINEAR, WHOLE_NONLINEAR = 2.5, 5.0  # %, bounds on the modal region and on `auto`
SEED = 5
NEAR_DENT, MOST_TRIES = 0.02, 4  # tolerance of a wanted dent, and largest number of equilibria on the way to it
TOLERANCE, LONGEST = 1e-4, 10.0  # of settling, and s
MOST_JUDGED = 5000  # points; a larger organ takes many minutes to settle at every place
PRESS = 0.1  # N on the patch of the smallest organ whose ticks are timed; the same pressure on the others


class PlaceErrors(NamedTuple):
    """Errors of one place under one force, in percent, relative L2 of the surface at equilibrium."""

    place: int
    force: float  # N
    dent: float  # m, of the whole model
    settled: bool  # the whole model and `auto`
    modal_linear: float  # against the linear whole model
    modal: float  # against the whole model
    auto: float  # likewise, of a region that hands over automatically
    handed_over: bool  # to the whole model
    frozen: float | None  # None for cells, which have no such region
    linear: float  # the linear whole model against the whole model


class SizeErrors(NamedTuple):
    """Results for a bean of cells of some size: ticks of the whole and of a region, and worst errors, %."""

    points: int
    cells: int
    whole: Timing
    modal: Timing
    auto: bool  # whether `auto` takes a region there
    small: float | None  # under SMALL; None for more than MOST_JUDGED points
    dented: float | None  # under the force that dents by the first of DENTS


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    add_shared(parser, seconds=1.0, check=True)
    parser.add_argument(
        "--places", type=int, default=6, help="number of points drawn at random, in addition to the outermost"
    )
    parser.add_argument(
        "--points", type=int, nargs="+", default=[], help="also time bean-shaped bodies with these numbers of points"
    )


def run(args: argparse.Namespace) -> Result:
    """Measure what the arguments ask for."""
    if not 0 <= args.places <= 1000:
        raise UserError(f"--places {args.places} is outside 0..1000")
    if args.points and not 100 <= min(args.points) <= max(args.points) <= 64_000:
        raise UserError(f"--points {min(args.points)}..{max(args.points)} are outside 100..64000")
    organ = Organ.load(args.organ or shipped_organ())
    cases, sizes = measure(organ, args.places), measure_sizes(sorted(args.points), args.seconds)
    found = as_json(cases, sizes)
    return Result(found, text(organ, cases, sizes, found))


def measure(organ: Organ, count: int) -> list[PlaceErrors]:
    """Return for each of the outermost places and of `count` others a small force, and those that dent by DENTS."""
    whole, modal, auto = Simulation(organ), regional(organ, "modal"), regional(organ, "modal")
    auto.settings.local_region = LocalRegion.AUTO
    frozen = None if whole.variant == "cells" else regional(organ, "frozen")
    free = free_axes(whole.model)
    tangent = stiffness_matrix(whole.model)[free][:, free].tocsc()
    linear = splu(tangent, permc_spec="MMD_AT_PLUS_A")
    cases = []
    with rows.until_stopped():
        for place in rows.each(places(whole, count), "places"):
            unit = unit_load(organ, place)
            for force, answer, whole_settled in answers(whole, unit, place):
                load = np.zeros(3 * organ.n_nodes)
                load[: 3 * organ.n_surface] = force * unit.ravel()
                straight = np.zeros_like(load)
                straight[free] = linear.solve(load[free])
                surface = straight[: 3 * organ.n_surface].reshape(-1, 3)
                by_modes, _ = modal.settle(force * unit, TOLERANCE, LONGEST)
                by_choice, choice_settled = auto.settle(force * unit, TOLERANCE, LONGEST)
                by_freezing = None if frozen is None else frozen.settle(force * unit, TOLERANCE, LONGEST)[0]
                cases.append(
                    PlaceErrors(
                        place,
                        force,
                        float(np.linalg.norm(answer[place])),
                        bool(whole_settled and choice_settled),
                        off(by_modes, surface),
                        off(by_modes, answer),
                        off(by_choice, answer),
                        bool(auto.state.status.region == Region.WHOLE),
                        None if by_freezing is None else off(by_freezing, answer),
                        off(surface, answer),
                    )
                )
                rows.report(
                    f"point {place}, {force:.2f} N",
                    f"error modal {cases[-1].modal:.1f} %",
                    f"auto {cases[-1].auto:.1f} %",
                )
    return cases


def regional(organ: Organ, kind: str) -> Simulation:
    """Return a simulation with a local region under any load."""
    simulation = Simulation(organ, local_region=kind)
    simulation.settings.region_force = np.inf
    return simulation


def places(whole: Simulation, count: int) -> list[int]:
    """Return surface nodes to press: the outermost along each axis, and `count` at random; none near held nodes."""
    organ = whole.organ
    hops = hop_table(whole.model, organ.n_surface)
    far = np.flatnonzero(hops[organ.fixed].min(axis=0) > FAR_HOPS) if len(organ.fixed) else np.arange(organ.n_surface)
    along = organ.surface_positions[far]
    ends = np.concatenate([far[along.argmax(axis=0)], far[along.argmin(axis=0)]])
    drawn = np.random.default_rng(SEED).choice(far, count)
    return [int(node) for node in dict.fromkeys([*ends.tolist(), *drawn.tolist()])]


def unit_load(organ: Organ, place: int) -> Floats:
    """Return 1 N on the patch around a surface node, inwards, as forces (n_surface, 3) N."""
    nodes = patch(organ, place, PATCH_NODES)
    load = np.zeros((organ.n_surface, 3))
    load[nodes] = -surface_normals(organ.surface_positions, organ.surface_triangles)[place] / len(nodes)
    return load


def answers(whole: Simulation, unit: Floats, place: int) -> Iterator[tuple[float, Floats, bool]]:
    """Yield force, N, and equilibrium (n_surface, 3) m under the small load and those that dent by DENTS."""
    force = SMALL
    answer, settled = whole.settle(force * unit, TOLERANCE, LONGEST)
    yield force, answer, settled
    for wanted in DENTS:
        for _ in range(MOST_TRIES):
            force *= wanted / float(np.linalg.norm(answer[place]))
            answer, settled = whole.settle(force * unit, TOLERANCE, LONGEST)
            if abs(float(np.linalg.norm(answer[place])) - wanted) <= NEAR_DENT * wanted:
                break
        yield force, answer, settled


def measure_sizes(points: Sequence[int], seconds: float) -> list[SizeErrors]:
    """Return ticks and errors for uncalibrated beans of cells, each tick timed for some seconds."""
    made = {}
    with rows.until_stopped():
        for count in rows.each(points, "organs"):
            organ = prepared(bean(count), Settings())
            made[count] = organ, Simulation(organ), regional(organ, "modal")
    bursts: dict[str, Ticks] = {}
    for count, (organ, whole, modal) in made.items():
        nodes, forces = patch_load(organ, PRESS * min(points) / count)
        bursts[f"whole {count}"], bursts[f"modal {count}"] = Ticks(whole, nodes, forces), Ticks(modal, nodes, forces)
    timings = interleave(Phase(bursts, seconds, "sizes")) if bursts else {}
    found = []
    for count, (organ, whole, modal) in made.items():
        if f"modal {count}" not in timings:
            break
        taken, cells = not moves_whole(organ), len(organ.cell_nodes)
        errors: tuple[float | None, float | None] = (None, None)
        with rows.until_stopped():
            if count <= MOST_JUDGED and not rows.stopped():
                errors = _errors_handing_over(whole, modal, count)
        found.append(SizeErrors(count, cells, timings[f"whole {count}"], timings[f"modal {count}"], taken, *errors))
    return found


def _errors_handing_over(whole: Simulation, modal: Simulation, count: int) -> tuple[float, float]:
    """Return the worst errors at the outermost places, %, of a region that hands over: small, and dented."""
    modal.settings.local_region = LocalRegion.AUTO
    errors = []
    for place in progress.steps(places(whole, 0), f"{count} points, place"):
        unit = unit_load(whole.organ, place)
        cases = [(force, answer) for force, answer, _ in islice(answers(whole, unit, place), 2)]
        errors.append([off(modal.settle(force * unit, TOLERANCE, LONGEST)[0], answer) for force, answer in cases])
    small, dented = np.max(errors, axis=0)
    return float(small), float(dented)


def off(found: Floats, wanted: Floats) -> float:
    """Return the relative L2 error, %."""
    return float(100.0 * np.linalg.norm(found - wanted) / np.linalg.norm(wanted))


def as_json(cases: list[PlaceErrors], sizes: list[SizeErrors]) -> JsonObject:
    """Return the bounds on the worst errors of the modal region and of `auto`, every case and every size."""
    small = [case for case in cases if case.force == SMALL]
    bounds = [
        Bound(
            "modal against linear, small forces",
            max((case.modal_linear for case in small), default=None),
            WHOLE_LINEAR,
            "%",
        ),
        Bound("auto against the whole model, all forces", max(case.auto for case in cases), WHOLE_NONLINEAR, "%"),
        Bound("cases that converge", 100.0 * float(np.mean([case.settled for case in cases])), 100.0, "%", least=True),
    ]
    return {
        "bounds": [bound.as_json() for bound in bounds],
        "cases": [case._asdict() for case in cases],
        "sizes": [size._asdict() | {"whole": size.whole._asdict(), "modal": size.modal._asdict()} for size in sizes],
    }


def text(organ: Organ, cases: list[PlaceErrors], sizes: list[SizeErrors], found: JsonObject) -> str:
    """Return the tables and the bounds as text."""
    rows = [["point", "N", "indentation mm", "modal/linear %", "modal %", "auto %", "is", "frozen %", "linear %"]]
    for case in cases:
        frozen = "-" if case.frozen is None else f"{case.frozen:.1f}"
        errors = [f"{case.modal_linear:.1f}", f"{case.modal:.1f}", f"{case.auto:.1f}"]
        taken = ("whole" if case.handed_over else "region") + ("" if case.settled else ", not converged")
        number = [str(case.place), f"{case.force:.2f}", f"{1e3 * case.dent:.2f}"]
        rows.append([*number, *errors, taken, frozen, f"{case.linear:.1f}"])
    lines = [f"organ '{organ.name}': equilibrium surface, {PATCH_NODES}-node patches, relative L2", *aligned(rows)]
    if sizes:
        rows = [["points", "cells", "whole us", "modal us", "switching %, small", "3 mm", "auto uses"]]
        for size in sizes:
            times = [figure(1e6 * size.whole.median), figure(1e6 * size.modal.median)]
            errors = ["-" if error is None else f"{error:.1f}" for error in (size.small, size.dented)]
            errors += ["a region" if size.auto else "the whole"]
            rows.append([str(size.points), str(size.cells), *times, *errors])
        lines += [
            "",
            "bean-shaped bodies of cells, not calibrated; largest error at the outermost points",
            *aligned(rows),
        ]
    return "\n".join([*lines, "", *bound_lines(found["bounds"])])
