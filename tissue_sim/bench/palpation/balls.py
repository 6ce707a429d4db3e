"""`tissue_sim bench palpation --places N`: the force on a sphere at nodes, on edges and in triangles.

Balls of some mean edges of the organ's surface are pressed in at each, and slide over it.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence

import numpy as np

from tissue_sim.array_types import Floats
from tissue_sim.bench import rows
from tissue_sim.bench.palpation.presses import DEPTHS, Pressed, presses
from tissue_sim.bench.palpation.slab import slab
from tissue_sim.bench.palpation.slides import SLID_DEPTH, SLID_LENGTH, SlidingPress, slides
from tissue_sim.bench.printing import Bound, Result, aligned, bound_lines
from tissue_sim.errors import UserError
from tissue_sim.identification.places import KINDS, flat_locations
from tissue_sim.json_types import JsonObject
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.shipped import shipped_organ
from tissue_sim.organ.tool_resolution import FAIR, FAIR_WITHIN, FINE, FINE_WITHIN, mean_edge

RADII = 0.5, 0.8, 1.0, 1.5, 2.0, 3.0  # mean edges
LEAST_RADIUS, MOST_RADIUS, MOST_PLACES = 0.2, 5.0, 100
MOST_RIPPLE = 5.0  # %


def run(args: argparse.Namespace) -> Result:
    """Measure what the arguments ask for."""
    radii = parse_radii(args.radii)
    if not 1 <= args.places <= MOST_PLACES:
        raise UserError(f"--places {args.places} is outside 1..{MOST_PLACES}")
    if args.slab and args.organ:
        raise UserError("--slab and an ORGAN are both given; choose one")
    if args.out:
        raise UserError("--out draws the palpation of a tumour; leave it out with --places")
    organ = slab() if args.slab else Organ.load(args.organ or shipped_organ())
    edge = mean_edge(organ)
    places = flat_locations(organ, args.places)
    pressed: list[Pressed] = []
    slid: list[SlidingPress] = []
    with rows.until_stopped():
        for press in presses(organ, radii, places):
            pressed.append(press)
            worst = np.nanmax(np.abs(press.off), initial=0.0)
            rows.report(f"{press.radius:g} edges, point {press.place}, {press.kind}", f"error at most {worst:.1f} %")
        for slide in slides(organ, radii, places):
            slid.append(slide)
            rows.report(f"{slide.radius:g} edges, point {slide.place}, sliding", f"ripple {slide.ripple:.1f} %")
    found = as_json(pressed, slid) | {"organ": organ.name, "edge_m": edge, "places": len(places)}
    return Result(found, text(found))


def parse_radii(given: str | None) -> tuple[float, ...]:
    """Return the radii, mean edges, of a text like `0.5,1,2`. Raises UserError for others, or out of range."""
    if given is None:
        return RADII
    try:
        radii = tuple(float(one) for one in given.split(","))
    except ValueError:
        raise UserError(f"--radii '{given}' are not numbers; write them as 0.5,1,2") from None
    for radius in radii:
        if not LEAST_RADIUS <= radius <= MOST_RADIUS:
            raise UserError(f"--radii {radius:g} is outside {LEAST_RADIUS:g}..{MOST_RADIUS:g} edges")
    return radii


def as_json(pressed: Sequence[Pressed], slid: Sequence[SlidingPress]) -> JsonObject:
    """Return all figures: of each radius, each press and each slide, and the bounds."""
    radii = list(dict.fromkeys(one.radius for one in pressed))
    table = [
        {
            "radius_edges": radius,
            **{kind: _figures([one for one in pressed if (one.radius, one.kind) == (radius, kind)]) for kind in KINDS},
        }
        for radius in radii
    ]
    fine, fair = ([one for one in pressed if low <= one.radius < high] for low, high in ((FINE, np.inf), (FAIR, FINE)))
    ripples = [one.ripple for one in slid if one.radius >= FINE]
    bounds = [
        Bound(
            f"error of the force against finite elements, radii of at least {FINE:g} edge, worst",
            _worst(fine),
            FINE_WITHIN,
            "%",
        ),
        Bound(
            f"error of the force against finite elements, radii of {FAIR:g} to {FINE:g} edge, worst",
            _worst(fair),
            FAIR_WITHIN,
            "%",
        ),
        Bound(
            "ripple of a sliding sphere, radii of at least 1 edge, worst", max(ripples, default=None), MOST_RIPPLE, "%"
        ),
    ]
    return {
        "radii": table,
        "presses": [
            {
                "radius_edges": one.radius,
                "place": one.place,
                "kind": one.kind,
                "depth_radii": one.depths.tolist(),
                "force_n": one.ours.tolist(),
                "reference_n": _known(one.reference),
                "off_percent": _known(one.off),
            }
            for one in pressed
        ],
        "slides": [
            {
                "radius_edges": one.radius,
                "place": one.place,
                "friction": one.friction,
                "force_n": one.force,
                "ripple_percent": one.ripple,
                "carried_m": one.carried,
            }
            for one in slid
        ],
        "bounds": [one.as_json() for one in bounds],
    }


def _known(values: Floats) -> list[float | None]:
    return [float(value) if np.isfinite(value) else None for value in values]


def _offs(pressed: Sequence[Pressed]) -> Floats:
    """Return all differences, (k,) %, where finite elements settled."""
    every = np.concatenate([one.off for one in pressed]) if pressed else np.zeros(0)
    return np.asarray(every[np.isfinite(every)])


def _worst(pressed: Sequence[Pressed]) -> float | None:
    return float(np.abs(_offs(pressed)).max(initial=0.0)) if len(_offs(pressed)) else None


def _figures(pressed: Sequence[Pressed]) -> JsonObject:
    """Return the difference that is largest, with its sign, and the median, %; how many there are, and aren't."""
    offs, tried = _offs(pressed), sum(len(one.depths) for one in pressed)
    if not len(offs):
        return {"worst_percent": None, "median_percent": None, "compared": 0, "unsettled": tried}
    return {
        "worst_percent": float(offs[np.abs(offs).argmax()]),
        "median_percent": float(np.median(offs)),
        "compared": len(offs),
        "unsettled": tried - len(offs),
    }


def text(found: JsonObject) -> str:
    """Return the figures as tables."""
    edge = found["edge_m"]
    table = [["radius, edges", "mm", *(f"{kind}: {what}" for kind in KINDS for what in ("worst", "median"))]]
    unsettled = 0
    for row in found["radii"]:
        cells = [f"{row['radius_edges']:g}", f"{1e3 * edge * row['radius_edges']:.1f}"]
        for kind in KINDS:
            cells += [_signed(row[kind][what]) for what in ("worst_percent", "median_percent")]
            unsettled += row[kind]["unsettled"]
        table.append(cells)
    slid = [["radius, edges", "friction", "force N", "carried mm", "ripple: worst", "median"]]
    for radius, friction in dict.fromkeys((one["radius_edges"], one["friction"]) for one in found["slides"]):
        own = [one for one in found["slides"] if (one["radius_edges"], one["friction"]) == (radius, friction)]
        ripples = [one["ripple_percent"] for one in own]
        force, carried = (float(np.median([one[key] for one in own])) for key in ("force_n", "carried_m"))
        cells = [f"{radius:g}", f"{friction:g}", f"{force:.3f}", f"{1e3 * carried:.1f}"]
        slid.append([*cells, f"{max(ripples):.1f} %", f"{np.median(ripples):.1f} %"])
    deep = ", ".join(f"{depth:g}" for depth in DEPTHS)
    lines = [
        f"organ '{found['organ']}', mean edge {1e3 * edge:.2f} mm: spheres without slip, {deep} radii deep at"
        f" {found['places']} flat points, error against finite elements",
        "",
        *aligned(table),
        *([f"the finite elements did not converge {unsettled} times; these are excluded"] if unsettled else []),
        "",
        f"spheres that slide {SLID_LENGTH:g} edges, {SLID_DEPTH:g} radii deep: half the force's range about a parabola,"
        " and how far they carry the surface along",
        "",
        *aligned(slid),
        "",
        *bound_lines(found["bounds"]),
    ]
    return "\n".join(lines)


def _signed(value: float | None) -> str:
    return "-" if value is None else f"{value:+.1f} %"
