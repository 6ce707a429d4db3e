"""Uncertainty of a fitted modulus, and the further press that would reduce it most."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree
from scipy.stats import norm, t

from tissue_sim.array_types import Floats, Longs
from tissue_sim.identification.force_curves import Curves, ForceCurves
from tissue_sim.identification.measured import Samples
from tissue_sim.identification.mixed_effects import FRACTION, NOISE, Fit, Priors, fitted
from tissue_sim.identification.places import clear_of_clamp
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.tool_resolution import mean_edge

LEVEL = 0.95
DRAWS = 200
# Standard deviation of the part of the model's error that all presses of one tool share, by the tool's radius in mean
# edges: means over node, edge and triangle in `tissue_sim bench palpation --places` (+0.7, +0.8, -0.3 % from 1.5 edges
# on; +2.3, +1.0, +1.8, +2.0 % at one; +2.4, -4.4, +3.6 % below), their root mean square rounded up, since they are few.
# What depends on where a tool meets the mesh varies from place to place, and shows in the presses themselves.
OWN_ERROR = ((1.5, 0.01), (1.0, 0.02), (0.0, 0.04))
FEW = 4  # places, below which their spread is that of the fit, which contains a prior
DEPTHS = (0.25, 0.5, 0.75, 1.0)  # radii, of presses that are considered
ENOUGH = 1.1  # times the least variance, at which a press is deep enough
SAMPLES = 20  # of a press that is considered
CLEAR = 3.0  # mean edges from the clamp
PROPOSED = 3  # places that are proposed


class Interval(NamedTuple):
    """Interval of a factor: its ends, and standard deviations of its logarithm from the presses and from the model."""

    low: float
    high: float
    from_presses: float
    from_model: float


class NextPress(NamedTuple):
    """Press that would narrow the interval most: depth m, the interval's half-width after it, relative; places m."""

    depth: float
    width: float
    places: Floats


def model_error(organ: Organ, radius: float) -> float:
    """Return the standard deviation of the model's error that all presses of a tool, its radius in m, share."""
    edges = radius / mean_edge(organ)
    return next(error for least, error in OWN_ERROR if edges >= least)


def drawn_factors(curves: Curves, samples: Samples, priors: Priors, fit: Fit, place: Longs, seed: int = 0) -> Floats:
    """Return the factors, (k,), of fits to presses drawn with replacement, place by place (n,)."""
    return np.asarray(np.exp(drawn_unknowns(curves, samples, priors, fit, place, seed)[:, 0]))


def drawn_unknowns(curves: Curves, samples: Samples, priors: Priors, fit: Fit, place: Longs, seed: int = 0) -> Floats:
    """Return the common unknowns, (k, 3 + l), of fits to presses drawn with replacement, place by place (n,)."""
    random = np.random.default_rng(seed)
    count = int(place.max()) + 1
    found = np.empty((DRAWS, len(fit.common)))
    for number in range(DRAWS):
        times = np.bincount(random.integers(0, count, count), minlength=count)[place].astype(np.float64)
        found[number] = fitted(curves, samples, priors, fit, times).common
    return found


def spread_by_places(drawn: Floats, places: int) -> float:
    """Return the standard deviation of an unknown, from its values (k,) in a bootstrap over so many places."""
    return float(np.std(drawn) * np.sqrt(places / max(places - 1, 1)))


def quantile_by_places(places: int) -> float:
    """Return how many standard deviations an interval reaches to each side, with as many places behind them."""
    return float(t.ppf(0.5 + 0.5 * LEVEL, max(places - 1, 1)))


def interval_of(fit: Fit, drawn: Floats, places: int, own_error: float) -> Interval:
    """Return the 95 % interval of a fit's factor.

    Parameters
    ----------
    fit : Fit
        The fit.
    drawn : Floats, shape (k,)
        Factors of the bootstrap.
    places : int
        Number of places.
    own_error : float
        Standard deviation of the model's own error.

    Returns
    -------
    Interval
        The bootstrap's spread, for fewer than four places the fit's own where that is larger, widened by Student's t,
        with the model's error added in squares.
    """
    by_presses = spread_by_places(np.log(drawn), places)
    if places < FEW:
        by_presses = max(by_presses, float(np.sqrt(fit.covariance[0, 0])))
    many = float(norm.ppf(0.5 + 0.5 * LEVEL))
    half = many * np.hypot(quantile_by_places(places) / many * by_presses, own_error)
    return Interval(fit.factor * np.exp(-half), fit.factor * np.exp(half), by_presses, own_error)


def next_press(
    organ: Organ, curves: ForceCurves, radius: float, priors: Priors, found: tuple[Fit, Interval, Floats | None]
) -> NextPress:
    """Return the press that would narrow the interval most.

    Parameters
    ----------
    organ : Organ
        The organ.
    curves : ForceCurves
        Curves of the presses that there are; the first one stands for further ones.
    radius : float, m
        Radius of the tool.
    priors : Priors
        As for `fitted`.
    found : tuple[Fit, Interval, Floats | None]
        The fit, its interval, and the pressed points (n, 3) m; None where these are not in the organ's axes.

    Returns
    -------
    NextPress
        The least depth that is about as informative as any, and the places farthest from those that were pressed.
    """
    fit, interval, points = found
    variances = [_variance(curves, fit, priors, fraction * radius) for fraction in DEPTHS]
    chosen = next(index for index, one in enumerate(variances) if one <= ENOUGH * min(variances))
    after = 1.0 / (1.0 / interval.from_presses**2 + 1.0 / variances[chosen])
    width = float(norm.ppf(0.5 + 0.5 * LEVEL)) * float(np.sqrt(after + interval.from_model**2))
    places = np.zeros((0, 3)) if points is None else _farthest(organ, points)
    return NextPress(DEPTHS[chosen] * radius, width, places)


def _variance(curves: ForceCurves, fit: Fit, priors: Priors, depth: float) -> float:
    """Return the variance of the log modulus that one press to a depth, m, would give, its offset unknown."""
    one = curves.some(np.array([0]))
    begin = float(one.start[one.which[0]]) - fit.common[1]
    depths = (begin + np.linspace(0.0, depth, SAMPLES))[None]
    force, slope = one.at(depths + fit.common[1])
    model, slope = fit.factor * force[0], fit.factor * slope[0]
    moved = np.stack([model, slope, np.ones_like(model)], axis=1)
    weight = 1.0 / (fit.noise * (NOISE + FRACTION * model)) ** 2
    information = (moved.T * weight) @ moved + np.diag([0.0, priors.offset**-2, priors.bias**-2])
    return float(np.linalg.inv(information)[0, 0]) + fit.spread**2


def _farthest(organ: Organ, points: Floats) -> Floats:
    """Return the surface nodes (k, 3) m that are farthest from pressed points and clear of the clamp."""
    positions, taken = organ.surface_positions, points
    candidates = positions[clear_of_clamp(organ, positions, CLEAR)]
    chosen = []
    for _ in range(min(PROPOSED, len(candidates))):
        chosen.append(candidates[int(cKDTree(taken).query(candidates)[0].argmax())])
        taken = np.vstack([taken, chosen[-1]])
    return np.array(chosen).reshape(-1, 3)
