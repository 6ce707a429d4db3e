"""The option --refine of `tissue_sim build`: where the surface's edges are to be shorter."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tissue_sim.errors import UserError
from tissue_sim.organ.refinement import Along, Ball, Painted, Refinement

HELP = (
    "more points in some places, beside --points; may be given several times. 'thin': where the body is thin; 'clamp':"
    " near the edge of what is held; 'auto': both, as 'tissue_sim calibrate' asks for. X,Y,Z:RADIUS[:EDGE]: around a"
    " point that will be touched, mm in the organ's frame; X,Y,Z/X,Y,Z/...:RADIUS[:EDGE]: along a line that will be"
    " cut; MASK[:EDGE]: within a mask image, such as a painted region; EDGE: mm, the edges'"
    " length there (default: half the usual)"
)
_WORDS = {"thin": (True, False), "clamp": (False, True), "auto": (True, True)}
_FORMS = "thin, clamp, auto, X,Y,Z:RADIUS[:EDGE] or X,Y,Z/X,Y,Z:RADIUS[:EDGE] in mm, or MASK[:EDGE]"


def parse_refine(given: Sequence[str]) -> Refinement:
    """Return what the texts of --refine ask for. Raises UserError for anything else, and as readers of masks do."""
    thin = clamp = False
    places: list[Ball | Along | Painted] = []
    for text in given:
        if text in _WORDS:
            thin, clamp = thin or _WORDS[text][0], clamp or _WORDS[text][1]
        else:
            places.append(_marked(text) or _painted(text))
    return Refinement(thin, clamp, tuple(places))


def _marked(text: str) -> Ball | Along | None:
    """Return the ball of X,Y,Z:RADIUS[:EDGE], or the line of X,Y,Z/X,Y,Z:RADIUS[:EDGE]; None for other texts."""
    parts = text.split(":")
    points = [_numbers(point.split(",")) for point in parts[0].split("/")]
    given = [point for point in points if point is not None and len(point) == 3]
    if len(given) < len(points):
        return None
    sizes = _numbers(parts[1:])
    if sizes is None or len(sizes) not in (1, 2) or min(sizes) <= 0.0:
        form = "X,Y,Z" if len(given) == 1 else "X,Y,Z/X,Y,Z"
        raise UserError(f"--refine {text} needs a radius, and may have an edge, in mm: {form}:RADIUS[:EDGE]")
    radius, edge = 1e-3 * sizes[0], 1e-3 * sizes[1] if len(sizes) > 1 else None
    line = 1e-3 * np.array(given)
    return Ball(line[0], radius, edge) if len(line) == 1 else Along(line, radius, edge)


def _painted(text: str) -> Painted:
    """Return the region that MASK[:EDGE] names."""
    from tissue_sim.organ.imaging.masks import read_mask

    name, _, last = text.rpartition(":")
    edge = _numbers([last]) if name else None
    path = Path(name if edge else text)
    if not path.exists():
        raise UserError(f"--refine {text} is not understood; use {_FORMS}, where MASK is an image file that exists")
    if edge and edge[0] <= 0.0:
        raise UserError(f"--refine {text}: an edge of {edge[0]:g} mm is invalid; give one greater than 0")
    return Painted(read_mask(path).upright(), 1e-3 * edge[0] if edge else None)


def _numbers(texts: Sequence[str]) -> list[float] | None:
    """Return the finite numbers of the texts; None where one is not a number."""
    try:
        found = [float(text) for text in texts]
    except ValueError:
        return None
    return found if all(np.isfinite(found)) else None
