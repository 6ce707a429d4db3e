"""The option --refine of `tissue_sim build`: where the surface's edges are to be shorter."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tissue_sim.errors import UserError
from tissue_sim.organ.refinement import Ball, Painted, Refinement

HELP = (
    "more points in some places, beside --points; may be given several times. 'thin': where the body is thin; 'clamp':"
    " near the edge of what is held; 'auto': both, as 'tissue_sim calibrate' asks for. X,Y,Z:RADIUS[:EDGE]: around a"
    " point that will be touched, mm in the organ's frame; MASK[:EDGE]: within a mask image, such as a painted region;"
    " EDGE: mm, the edges' length there (default: half the usual)"
)
_WORDS = {"thin": (True, False), "clamp": (False, True), "auto": (True, True)}
_FORMS = "thin, clamp, auto, X,Y,Z:RADIUS[:EDGE] in mm, or MASK[:EDGE]"


def parse_refine(given: Sequence[str]) -> Refinement:
    """Return what the texts of --refine ask for. Raises UserError for what is none of the forms, or a mask's reader."""
    thin = clamp = False
    places: list[Ball | Painted] = []
    for text in given:
        if text in _WORDS:
            thin, clamp = thin or _WORDS[text][0], clamp or _WORDS[text][1]
        else:
            places.append(_ball(text) or _painted(text))
    return Refinement(thin, clamp, tuple(places))


def _ball(text: str) -> Ball | None:
    """Return the ball that X,Y,Z:RADIUS[:EDGE] names; None for other texts."""
    parts = text.split(":")
    centre = _numbers(parts[0].split(","))
    if centre is None or len(centre) != 3:
        return None
    sizes = _numbers(parts[1:])
    if sizes is None or len(sizes) not in (1, 2) or min(sizes) <= 0.0:
        raise UserError(f"--refine {text} needs a radius, and may have an edge, in mm: X,Y,Z:RADIUS[:EDGE]")
    return Ball(1e-3 * np.array(centre), 1e-3 * sizes[0], 1e-3 * sizes[1] if len(sizes) > 1 else None)


def _painted(text: str) -> Painted:
    """Return the region that MASK[:EDGE] names."""
    from tissue_sim.organ.imaging.masks import read_mask

    name, _, last = text.rpartition(":")
    edge = _numbers([last]) if name else None
    path = Path(name if edge else text)
    if not path.exists():
        raise UserError(f"--refine {text} is not understood; use {_FORMS}, where MASK is an image file that exists")
    if edge and edge[0] <= 0.0:
        raise UserError(f"--refine {text}: an edge of {edge[0]:g} mm is none; give one greater than 0")
    return Painted(read_mask(path).upright(), 1e-3 * edge[0] if edge else None)


def _numbers(texts: Sequence[str]) -> list[float] | None:
    """Return the finite numbers of the texts; None where one is no number."""
    try:
        found = [float(text) for text in texts]
    except ValueError:
        return None
    return found if all(np.isfinite(found)) else None
