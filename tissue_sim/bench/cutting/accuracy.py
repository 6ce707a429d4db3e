"""`tissue_sim bench cut --accuracy`: the real-time model of cut organs against finite elements with the same cut."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tissue_sim.array_types import Floats
from tissue_sim.bench import rows
from tissue_sim.bench.cutting.cuts import CUTS, OPENING, Cut, placed
from tissue_sim.bench.cutting.modelled import Modelled
from tissue_sim.bench.cutting.reference import OPENED, Reference, patch_force, reference_of, stored_table
from tissue_sim.bench.printing import Bound, aligned, bound_lines
from tissue_sim.calibration.evaluation import errors
from tissue_sim.errors import UserError
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.surfaces.sizing import mean_edge

MOST_MEAN, MOST_WORST, MOST_GAP, MOST_FORCE = 4.0, 15.0, 20.0, 10.0  # %
CHANGES = 5.0  # %, by which the cut changes the displacement under a load whose released energy is compared


class Compared(NamedTuple):
    """Errors of a cut, %, of c loads."""

    cut: Cut
    edges: float  # depth, in mean edges of the surface
    resolved: bool
    names: tuple[str, ...]
    error: Floats  # (c,) of the displacement
    free_error: Floats  # (c,) the same against lips that pass through each other, as the model's do
    gap: Floats  # (c,) of the opening along the lips
    uncut: Floats  # (c,) of the uncut organ, against finite elements without the cut
    left_out: Floats  # (c,) of the uncut organ, against finite elements with the cut
    touch: NDArray[np.bool_]  # (c,) whether the lips touch
    settled: NDArray[np.bool_]  # (c,) of both
    force: float  # of the force that opens the middle by OPENED; nan where it isn't known
    energy: float  # of the energy that the cut releases; nan where it isn't known
    off: float  # of the reference, at most


def compared(organ: Organ, cut: Cut, reference: Reference, edge: float) -> Compared:
    """Settle the real-time model under the loads of a reference.

    Parameters
    ----------
    organ : Organ
        The organ.
    cut : Cut
        The cut.
    reference : Reference
        Its finite elements.
    edge : float, m
        Mean edge of the organ's surface.

    Returns
    -------
    Compared
        The errors.

    Raises
    ------
    UserError
        As Simulation.cut does.
    """
    whole, opened = Modelled(organ, None), Modelled(organ, placed(organ, cut))
    without, found = ([one.settle(force) for force in reference.force] for one in (whole, opened))
    moved, uncut = (np.array([one.answer.displacement for one in each]) for each in (found, without))
    opening = np.array([one.answer.opening for one in found])
    released = np.array([one.potential - other.potential for one, other in zip(without, found, strict=True)])
    changed = 100.0 * errors(reference.uncut, reference.free) > CHANGES
    off = 100.0 * np.abs(released / reference.released - 1.0)
    which = reference.names.index(OPENING)
    size = patch_force(reference.force[which])
    needed = opened.opening_force(reference.force[which], size, OPENED)
    return Compared(
        cut=cut,
        edges=cut.depth / edge,
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
    )


def measure(makers: Mapping[str, Callable[[], Organ]], chosen: Iterable[str]) -> tuple[list[Compared], list[str]]:
    """Compare every cut of some organs; return the comparisons, and why others were left out.

    Parameters
    ----------
    makers : Mapping[str, Callable[[], Organ]]
        What makes each organ, by name.
    chosen : Iterable[str]
        Names of the organs.
    """
    stored, made = stored_table(), cache(lambda name: makers[name]())
    found: list[Compared] = []
    skipped: dict[str, str] = {}
    chosen = tuple(chosen)
    with rows.until_stopped():
        for cut in rows.each([one for one in CUTS if one.organ in chosen], "cuts"):
            try:
                organ = made(cut.organ)
                reference = reference_of(organ, cut, stored)
            except UserError as error:
                skipped[cut.organ] = f"{cut.organ} is left out: {error}"
                continue
            edge = mean_edge(organ.surface_positions, organ.surface_triangles)
            found.append(compared(organ, cut, reference, edge))
            rows.tell(cut.name, f"{found[-1].error.mean():.1f} % on average, {found[-1].error.max():.1f} % at worst")
    return found, list(skipped.values())


# telling -------------------------------------------------------------------------------------------


def as_json(found: list[Compared], skipped: list[str]) -> dict[str, Any]:
    """Return all figures and bounds.

    Parameters
    ----------
    found : list[Compared]
        The comparisons.
    skipped : list[str]
        Why others were left out.

    Returns
    -------
    dict[str, Any]
        The figures by name.
    """
    table = [_row(one.cut.name, [one]) | _own(one) for one in found]
    if found:
        table.append(_row("all", found))
        resolved = [one for one in found if one.resolved]
        table.append(_row("all, lips apart", found, lambda one: ~one.touch))
        table.append(_row("all, lips touch", found, lambda one: one.touch))
        table.append(_row("resolved, lips apart", resolved, lambda one: ~one.touch))
    loads = [
        _row(name, found, lambda one, name=name: np.array([other == name for other in one.names]))  # type: ignore[misc]
        for name in (found[0].names if found else ())
    ]
    forces = [abs(one.force) for one in found]
    worst = max(forces) if forces and all(map(math.isfinite, forces)) else None
    bounds = []
    for name, rule in (("lips apart", lambda one: ~one.touch), ("lips touch", lambda one: one.touch)):
        row = _row(name, found, rule)
        bounds += [
            Bound(f"displacement, {name}: mean", row["mean_percent"], MOST_MEAN, "%"),
            Bound(f"displacement, {name}: worst", row["worst_percent"], MOST_WORST, "%"),
            Bound(f"opening of the lips, {name}: mean", row["gap_percent"], MOST_GAP, "%"),
        ]
    bounds.append(Bound("force that opens a cut by 5 mm, worst cut", worst, MOST_FORCE, "%"))
    return {"rows": table, "loads": loads, "skipped": skipped, "bounds": [one.as_json() for one in bounds]}


def _row(
    name: str, found: list[Compared], chosen: Callable[[Compared], NDArray[np.bool_]] | None = None
) -> dict[str, Any]:
    """Return the figures of some loads on some cuts; None where there is none."""

    def of(field: str) -> Floats:
        parts = [
            getattr(one, field)[one.settled & (chosen(one) if chosen else np.ones(len(one.settled), dtype=bool))]
            for one in found
        ]
        return np.concatenate(parts) if parts else np.zeros(0)

    def mean(field: str) -> float | None:
        return float(of(field).mean()) if len(of(field)) else None

    def worst(field: str) -> float | None:
        return float(of(field).max()) if len(of(field)) else None

    return {
        "name": name,
        "loads": len(of("error")),
        "uncut_mean_percent": mean("uncut"),
        "uncut_worst_percent": worst("uncut"),
        "mean_percent": mean("error"),
        "worst_percent": worst("error"),
        "free_mean_percent": mean("free_error"),
        "free_worst_percent": worst("free_error"),
        "gap_percent": mean("gap"),
        "left_out_mean_percent": mean("left_out"),
        "left_out_worst_percent": worst("left_out"),
    }


def _own(one: Compared) -> dict[str, Any]:
    """Return the figures that belong to a cut as a whole, and those of each load."""
    return {
        "edges": one.edges,
        "resolved": one.resolved,
        "touching": int(one.touch.sum()),
        "not_settled": int(np.count_nonzero(~one.settled)),
        "force_percent": one.force if math.isfinite(one.force) else None,
        "energy_percent": one.energy if math.isfinite(one.energy) else None,
        "reference_percent": one.off,
        "load_names": list(one.names),
        "load_percent": one.error.tolist(),
        "load_gap_percent": one.gap.tolist(),
        "load_touches": one.touch.tolist(),
    }


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
    head = [
        "cut, mm",
        "edges",
        "loads",
        "touch",
        "uncut",
        "cut",
        "lips free",
        "gap",
        "left out",
        "force",
        "energy",
        "+-",
    ]
    table = [head]
    for row in found["rows"]:
        edges = "-" if "edges" not in row else f"{row['edges']:.1f}{'' if row['resolved'] else ' *'}"
        own = [_number(row.get(key)) for key in ("force_percent", "energy_percent", "reference_percent")]
        pairs = [
            f"{_number(row[f'{key}mean_percent'])} / {_number(row[f'{key}worst_percent'])}"
            for key in ("uncut_", "", "free_", "left_out_")
        ]
        counts = [str(row["loads"]), str(row.get("touching", "-"))]
        table.append([row["name"], edges, *counts, *pairs[:3], _number(row["gap_percent"]), pairs[3], *own])
    by_load = [["load", "loads", "uncut", "cut", "lips free", "gap"]]
    for row in found["loads"]:
        pairs = [
            f"{_number(row[f'{key}mean_percent'])} / {_number(row[f'{key}worst_percent'])}"
            for key in ("uncut_", "", "free_")
        ]
        by_load.append([row["name"], str(row["loads"]), *pairs, _number(row["gap_percent"])])
    lines = [
        "errors in % against finite elements, mean / worst of the loads: of displacements of the surface (uncut: of",
        "the organ before the cut; cut: against lips that touch each other; lips free: against lips that pass through",
        "each other; left out: of the uncut organ against the cut one), of the opening along the lips (gap), of the",
        "force that opens the cut by 5 mm, and of the energy that the cut releases; edges: depth in mean edges of the",
        "surface, * not resolved; touch: loads under which lips touch; +-: error of the finite elements, at most",
        "",
        *aligned(table),
        "",
        *aligned(by_load),
        "",
        *found["skipped"],
        *([""] if found["skipped"] else []),
        *bound_lines(found["bounds"]),
    ]
    return "\n".join(lines)


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.1f}"
