"""Places that are far stiffer than the others, as over an inclusion that the organ doesn't have."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tissue_sim.array_types import Floats, Longs
from tissue_sim.identification.mixed_effects import Fit

ENOUGH = 8  # places, to know how much they vary
OUTSIDE = 4.0  # robust standard deviations above the median
LEAST, LEAST_SPREAD = 0.05, 0.01  # of the modulus: of what is reported, and of how much places vary
NORMAL = 1.4826  # standard deviation of a normal distribution over its median absolute deviation


class StiffPlaces(NamedTuple):
    """Presses at stiff places (k,), one of each, and by how much the stiffest place exceeds the median, relative.

    The stiffest place comes first.
    """

    presses: Longs
    excess: float


def stiff_places(fit: Fit, place: Longs) -> StiffPlaces:
    """Return the places whose modulus is far above that of the others.

    Parameters
    ----------
    fit : Fit
        Presses and their deviations.
    place : Longs, shape (n,)
        Place of each press, from 0. The mean of a place counts, which is surer the more often it was pressed.

    Returns
    -------
    StiffPlaces
        The stiffest press of each stiff place; none for fewer than eight places.
    """
    own, pressed = fit.own[:, 0], np.bincount(place)
    if len(pressed) < ENOUGH:
        return StiffPlaces(np.zeros(0, dtype=np.int64), 0.0)
    mean = np.bincount(place, own) / pressed
    middle = float(np.median(mean))
    spread = max(NORMAL * float(np.median(np.abs(mean - middle))), LEAST_SPREAD)
    order = np.argsort(-mean, kind="stable")
    chosen = order[mean[order] - middle > max(OUTSIDE * spread, LEAST)]
    rows = [int(np.where(place == one, own, -np.inf).argmax()) for one in chosen]
    return StiffPlaces(np.array(rows, dtype=np.int64), float(np.expm1(mean[order[0]] - middle)))


def line_of(found: StiffPlaces, names: list[str], points: Floats) -> str:
    """Return a line about stiff places; names of all presses, and their points (n, 3) m, NaN where unknown."""
    first = int(found.presses[0])
    point = points[first]
    at = " at ({:.1f}, {:.1f}, {:.1f}) mm".format(*(1e3 * point)) if np.isfinite(point).all() else ""
    others = f"; so are {', '.join(names[row] for row in found.presses[1:])}" if len(found.presses) > 1 else ""
    return (
        f"warning: the tissue under {names[first]}{at} is {100 * found.excess:.0f} % stiffer than at most places"
        f"{others}: something stiff that the organ file doesn't have may lie there"
    )
