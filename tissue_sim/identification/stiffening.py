"""Demiray's b that fits presses, how sure it is, and whether it is worth its number."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tissue_sim.array_types import Floats
from tissue_sim.identification.law_curves import LawCurves, stiffening_at
from tissue_sim.identification.measured import Samples
from tissue_sim.identification.mixed_effects import LAW, Fit, Priors, fitted
from tissue_sim.identification.uncertainty import drawn_unknowns, quantile_by_places, spread_by_places
from tissue_sim.identification.validation import GAIN, HeldOut, held_out, places_of
from tissue_sim.json_types import JsonObject


class Stiffening(NamedTuple):
    """Result for the exponential law.

    Attributes
    ----------
    b : float
        Demiray's b.
    low, high : float
        Ends of its 95 % interval; infinite where it reaches the largest b that was tried.
    plain_error, error : float
        Held-out error of the force with neo-Hookean tissue and with b, relative; NaN for presses at a single place.
    """

    b: float
    low: float
    high: float
    plain_error: float
    error: float

    @property
    def pays(self) -> bool:
        """Return whether the law lowers the held-out error by as much as a further unknown has to."""
        return self.error < GAIN * self.plain_error

    def as_json(self) -> JsonObject:
        """Return the figures, as JSON can hold them."""
        high = self.high if np.isfinite(self.high) else None
        found: JsonObject = {
            "law": "exponential" if self.pays else "neo-hookean",
            "fitted_stiffening": self.b,
            "fitted_stiffening_interval_95_percent": [self.low, high],
        }
        if np.isfinite(self.error):
            found["held_out_error_neo_hookean_percent"] = 100.0 * self.plain_error
            found["held_out_error_exponential_percent"] = 100.0 * self.error
        return found


class LawFit(NamedTuple):
    """Fit of curves with b, its common unknowns in a bootstrap (k, 4), and errors at held-out places."""

    curves: LawCurves
    stiffening: Stiffening
    fit: Fit
    drawn: Floats
    held_out: HeldOut | None


def law_fit(
    curves: LawCurves, samples: Samples, priors: Priors, points: Floats, radius: float, plain: HeldOut | None
) -> LawFit:
    """Return the fit of b, with a line about it.

    Parameters
    ----------
    curves : LawCurves
        The model's curves for every b.
    samples : Samples
        The measured forces.
    priors : Priors
        As for `fitted`.
    points : Floats, shape (n, 3), m
        Where presses first touched.
    radius : float, m
        Radius of the tool.
    plain : HeldOut | None
        Errors at held-out places with neo-Hookean tissue.

    Returns
    -------
    LawFit
        The interval of b is the bootstrap's spread of log(1 + b / 4), widened by Student's t.
    """
    place = places_of(points, radius)
    fit = fitted(curves, samples, priors)
    drawn = drawn_unknowns(curves, samples, priors, fit, place)
    errors = held_out(curves, samples, points, radius, priors)
    at, places = float(fit.common[LAW]), int(place.max()) + 1
    half = quantile_by_places(places) * spread_by_places(drawn[:, LAW], places)
    low, b, high = stiffening_at(np.clip([at - half, at, at + half], 0.0, 1.0))
    without, with_law = (np.nan if one is None else one.one for one in (plain, errors))
    found = Stiffening(float(b), float(low), float(high) if at + half < 1.0 else np.inf, without, with_law)
    return LawFit(curves, found, fit, drawn, errors)


def line_of(found: Stiffening) -> str:
    """Return a line about the law."""
    interval = f"{found.low:.1f} to {found.high:.1f}" if np.isfinite(found.high) else f"{found.low:.1f} or more"
    text = f"exponential law: b {found.b:.1f}, 95 % interval {interval}"
    if np.isnan(found.error):
        return f"{text}; not used, since presses at a single place can't show that it predicts others better"
    errors = f"held-out error {100 * found.error:.1f} %, {100 * found.plain_error:.1f} % with neo-Hookean tissue"
    if not found.pays:
        return f"{text}; not used: {errors}, and must be {100 * (1 - GAIN):.0f} % lower to be worth a number"
    return (
        f"{text}; used: {errors}. Presses can't distinguish tissue that stiffens from a thin layer on something hard:"
        " where the support is not the organ file's, b is not the tissue's"
    )
