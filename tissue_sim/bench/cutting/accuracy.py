"""`tissue_sim bench cut --accuracy`: the real-time model of cut organs against finite elements with the same cut."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from typing import NamedTuple

import numpy as np

from tissue_sim.array_types import Floats, Mask
from tissue_sim.bench import rows
from tissue_sim.bench.cutting.cuts import OPENING, Cut, placed
from tissue_sim.bench.cutting.finer import finer_organ, onto_finer
from tissue_sim.bench.cutting.modelled import Modelled
from tissue_sim.bench.cutting.reference import OPENED, Reference, patch_force, reference_of, stored_table
from tissue_sim.bench.printing import Bound, aligned, bound_lines
from tissue_sim.calibration.evaluation import errors
from tissue_sim.errors import UserError
from tissue_sim.json_types import JsonObject
from tissue_sim.organ.organ import Organ

MOST_MEAN, MOST_WORST, MOST_GAP, MOST_FORCE = 4.0, 15.0, 20.0, 10.0  # %
_HEAD = ("apart", "uncut", "cut", "gap", "left out", "touch", "cut", "free")
_OWN = ("edges", "lip", "force", "energy", "+-", "points", "cells", "step, us")
CHANGES = 5.0  # %, by which the cut changes the displacement under a load whose released energy is compared


class Compared(NamedTuple):
    """Errors of a cut, %, of c loads."""

    cut: Cut
    edges: float  # depth, in mean edges of the surface
    lip: float  # thickness of the thinner lip, in mean edges of the surface
    resolved: bool
    names: tuple[str, ...]
    error: Floats  # (c,) of the displacement
    free_error: Floats  # (c,) the same against lips that pass through each other, as the model's do
    gap: Floats  # (c,) of the opening along the lips
    uncut: Floats  # (c,) of the uncut organ, against finite elements without the cut
    left_out: Floats  # (c,) of the uncut organ, against finite elements with the cut
    touch: Mask  # (c,) whether the lips touch
    settled: Mask  # (c,) of both
    force: float  # of the force that opens the middle by OPENED; nan where it isn't known
    energy: float  # of the energy that the cut releases; nan where it isn't known
    off: float  # of the reference, at most
    points: int  # of the surface
    cells: int  # after the cut
    step: float  # s, critical one after the cut


def compared(organ: Organ, cut: Cut, reference: Reference, edge: float, finer: Organ | None = None) -> Compared:
    """Settle the real-time model under the loads of a reference.

    edge: mean edge of the organ's surface at the cut, m; finer: the organ with a finer surface, which takes its place,
    None for none. Returns the errors. Raises UserError as Simulation.cut does.
    """
    place = placed(organ, cut)
    onto = None if finer is None else onto_finer(organ, finer, place.sheet)
    whole, opened = (Modelled(finer or organ, where, onto) for where in (None, place))
    without, found = ([one.settle(force) for force in reference.force] for one in (whole, opened))
    moved, uncut = (np.array([one.answer.displacement for one in each]) for each in (found, without))
    opening = np.array([one.answer.opening for one in found])
    released = np.array([one.potential - other.potential for one, other in zip(without, found, strict=True)])
    # The energy is known of finite elements whose lips are free, so that loads that close them are left out.
    changed = (100.0 * errors(reference.uncut, reference.free) > CHANGES) & ~reference.touch
    off = 100.0 * np.abs(released / reference.released - 1.0)
    which = reference.names.index(OPENING)
    size = patch_force(reference.force[which])
    model = opened.simulation
    needed = opened.opening_force(reference.force[which], size, OPENED)
    return Compared(
        cut=cut,
        edges=cut.depth / edge,
        lip=model.cuts[-1].lip / edge,
        resolved=opened.resolved,
        names=reference.names,
        error=100.0 * errors(moved, reference.displacement),
        free_error=100.0 * errors(moved, reference.free),
        gap=100.0 * errors(opening, reference.opening),
        uncut=100.0 * errors(uncut, reference.uncut),
        left_out=100.0 * errors(uncut, reference.displacement),
        touch=reference.touch,
        settled=reference.settled & np.array([one.answer.settled for one in found]),
        force=100.0 * (needed / reference.opening_force - 1.0),
        energy=float(off[changed].mean()) if changed.any() else math.nan,
        off=float(reference.off.max()),
        points=organ.n_surface if finer is None else finer.n_surface,
        cells=len(model.organ.cell_nodes),
        step=model.critical_step,
    )


def measure(
    makers: Mapping[str, Callable[[], Organ]], cuts: Sequence[Cut], *, refine: bool = False
) -> tuple[list[Compared], list[str]]:
    """Compare some cuts; return the comparisons, and why others were left out.

    makers: what makes each organ, by name; refine: whether each organ's surface is made finer where the cut will be,
    and calibrated again.
    """
    stored, made = stored_table(), cache(lambda name: makers[name]())
    found: list[Compared] = []
    skipped: dict[str, str] = {}
    with rows.until_stopped():
        for cut in rows.each(cuts, "cuts"):
            try:
                organ = made(cut.organ)
                reference = reference_of(organ, cut, stored)
            except UserError as error:
                skipped[cut.organ] = f"{cut.organ} is left out: {error}"
                continue
            finer = finer_organ(organ, cut) if refine else None
            edge = placed(organ, cut).sheet.edge_at(finer or organ)
            found.append(compared(organ, cut, reference, edge, finer))
            rows.report(cut.name, f"{found[-1].error.mean():.1f} % on average, {found[-1].error.max():.1f} % at worst")
    return found, list(skipped.values())


# telling -------------------------------------------------------------------------------------------


def as_json(found: list[Compared], skipped: list[str]) -> JsonObject:
    """Return all figures and bounds. skipped: why others were left out."""
    table = [_row(one.cut.name, [one]) | _own(one) for one in found]
    if found:
        table.append(_row("all", found))
        table.append(_row("all resolved", [one for one in found if one.resolved]))
    loads = [_row(name, found, name) for name in (found[0].names if found else ())]
    whole = _row("all", found)
    forces = [abs(one.force) for one in found]
    worst = max(forces) if forces and all(map(math.isfinite, forces)) else None
    bounds = []
    for key, name in (("apart", "lips apart"), ("touch", "lips touch")):
        bounds += [
            Bound(f"displacement, {name}: mean", whole[key]["mean_percent"], MOST_MEAN, "%"),
            Bound(f"displacement, {name}: worst", whole[key]["worst_percent"], MOST_WORST, "%"),
            Bound(f"opening of the lips, {name}: mean", whole[key]["gap_percent"], MOST_GAP, "%"),
        ]
    bounds.append(Bound("force that opens a cut by 5 mm, worst cut", worst, MOST_FORCE, "%"))
    return {"rows": table, "loads": loads, "skipped": skipped, "bounds": [one.as_json() for one in bounds]}


def _row(name: str, found: list[Compared], load: str | None = None) -> JsonObject:
    """Return the figures of some cuts, of all loads or one: of those under which lips stay apart, and of the others."""

    def chosen(one: Compared, touch: bool) -> Mask:
        named = np.array([load in (None, other) for other in one.names])
        return named & one.settled & (one.touch == touch)

    return {
        "name": name,
        "apart": _figures(found, [chosen(one, False) for one in found]),
        "touch": _figures(found, [chosen(one, True) for one in found]),
    }


def _figures(found: list[Compared], chosen: list[Mask]) -> JsonObject:
    """Return the figures of chosen loads (c,) on some cuts; None where there is none."""

    def of(field: str) -> Floats:
        parts = [getattr(one, field)[some] for one, some in zip(found, chosen, strict=True)]
        return np.concatenate(parts) if parts else np.zeros(0)

    figures: JsonObject = {"loads": len(of("error"))}
    for key, field in (("", "error"), ("uncut_", "uncut"), ("free_", "free_error"), ("left_out_", "left_out")):
        values = of(field)
        figures[f"{key}mean_percent"] = float(values.mean()) if len(values) else None
        figures[f"{key}worst_percent"] = float(values.max()) if len(values) else None
    gap = of("gap")
    return figures | {"gap_percent": float(gap.mean()) if len(gap) else None}


def _own(one: Compared) -> JsonObject:
    """Return the figures that belong to a cut as a whole, and those of each load."""
    return {
        "edges": one.edges,
        "lip_edges": one.lip,
        "resolved": one.resolved,
        "not_settled": int(np.count_nonzero(~one.settled)),
        "force_percent": one.force if math.isfinite(one.force) else None,
        "energy_percent": one.energy if math.isfinite(one.energy) else None,
        "reference_percent": one.off,
        "points": one.points,
        "cells": one.cells,
        "critical_step_us": 1e6 * one.step,
        "load_names": list(one.names),
        "load_percent": one.error.tolist(),
        "load_gap_percent": one.gap.tolist(),
        "load_touches": one.touch.tolist(),
    }


def text(found: JsonObject) -> str:
    """Return the figures as tables."""
    lines = [
        "errors in % against finite elements with the same cut, whose lips touch each other; mean / worst of the loads",
        "under which they stay apart, and of those under which they touch: of displacements of the surface (uncut: of",
        "the organ before the cut; left out: of the uncut organ against the cut one; free: against lips that pass",
        "through each other, as the model's do), of the opening along the lips (gap), of the force that opens the cut",
        "by 5 mm, and of the energy that the cut releases; edges: depth in mean edges of the surface, * not resolved;",
        "lip: thickness of the thinner lip, in the same; +-: error of the finite elements, at most; points of the",
        "surface, cells after the cut, critical step",
        "",
        *aligned([["cut, mm", *_HEAD, *_OWN], *map(_cells, found["rows"])]),
        "",
        *aligned([["load", *_HEAD], *(_cells(row)[: len(_HEAD) + 1] for row in found["loads"])]),
        "",
        *found["skipped"],
        *([""] if found["skipped"] else []),
        *bound_lines(found["bounds"]),
    ]
    return "\n".join(lines)


def _cells(row: JsonObject) -> list[str]:
    """Return the cells of a row."""

    def pair(which: str, key: str) -> str:
        if not row[which]["loads"]:
            return "-"
        return f"{_number(row[which][f'{key}mean_percent'])} / {_number(row[which][f'{key}worst_percent'])}"

    apart, touch = row["apart"], row["touch"]
    edges = "-" if "edges" not in row else f"{row['edges']:.1f}{'' if row['resolved'] else ' *'}"
    own = [_number(row.get(key)) for key in ("lip_edges", "force_percent", "energy_percent", "reference_percent")]
    own += [f"{row[key]:.0f}" if key in row else "-" for key in ("points", "cells", "critical_step_us")]
    return [
        *(row["name"], str(apart["loads"]), pair("apart", "uncut_"), pair("apart", ""), _number(apart["gap_percent"])),
        *(pair("apart", "left_out_"), str(touch["loads"]), pair("touch", ""), pair("touch", "free_"), edges, *own),
    ]


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.1f}"
