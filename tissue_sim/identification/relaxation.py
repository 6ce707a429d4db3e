"""Relaxation of the force in holds: the fraction that decays, and one time constant.

The force follows the elastic one with a fading memory: F(t) = s (C(t) - g int (1 - exp(-(t - u) / tau)) dC(u)), Fung's
quasi-linear viscoelasticity with one Prony term. C is the model's elastic force along the recorded depths, so that what
relaxes while the tool enters counts as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from tissue_sim.array_types import Floats
from tissue_sim.identification.measured import Hold

LONG_ENOUGH = 10.0  # s, of a hold
WAY_IN, HELD = 60, 150  # samples of a hold to which a recording is averaged
STARTS = 5  # time constants from which the fit begins
SURE = 2.0  # standard deviations, by which a fraction is above none
VAGUE = 0.3  # of the time constant, standard deviation from which it isn't known
UNFIT = 0.01  # of the force, which a single term leaves unexplained at most


class Relaxation(NamedTuple):
    """Fraction of the force that decays and the time constant, s, with standard deviations; left: unexplained."""

    fraction: float
    time: float
    fraction_deviation: float
    time_deviation: float
    holds: int
    left: float

    def loss_factor(self, frequency: float) -> float:
        """Return the loss factor that it causes at a frequency, Hz."""
        turn = 2.0 * np.pi * frequency * self.time
        return self.fraction * turn / ((1.0 - self.fraction) + turn**2)


class _Thinned(NamedTuple):
    """Samples of a hold: time s, force N, the model's elastic force N, and how many are averaged; all (k,)."""

    time: Floats
    force: Floats
    elastic: Floats
    averaged: Floats


def relaxation_of(holds: Sequence[Hold], elastic: Sequence[Floats], has_times: bool) -> tuple[Relaxation | None, str]:
    """Return how forces relax in holds of 10 s, or None; and a line about it.

    Parameters
    ----------
    holds : Sequence[Hold]
        All holds.
    elastic : Sequence[Floats], each of shape (k,), N
        The model's elastic forces at each one's depths, up to a factor.
    has_times : bool
        Whether the recording has times.
    """
    before = "relaxation: not identifiable from this recording: "
    if not has_times:
        return None, before + "its samples have no times"
    longest = max((hold.length for hold in holds), default=0.0)
    some = [_thinned(*pair) for pair in zip(holds, elastic, strict=True) if pair[0].length >= LONG_ENOUGH]
    if not some:
        return None, f"{before}the longest hold lasts {longest:.1f} s, and {LONG_ENOUGH:g} s are needed"
    found = _fitted(some)
    if found.fraction < SURE * found.fraction_deviation or found.fraction <= 0.0:
        most = 100.0 * (max(found.fraction, 0.0) + SURE * found.fraction_deviation)
        return None, f"{before}no fraction of the force decays above its noise (at most {most:.1f} %)"
    if found.time > longest or found.time_deviation > VAGUE * found.time:
        return None, (
            f"{before}its time constant, {found.time:.1f} s with a standard deviation of {found.time_deviation:.1f} s,"
            f" isn't settled by holds of {longest:.1f} s: hold longer, or come in faster"
        )
    line = (
        f"relaxation: {100 * found.fraction:.1f} % of the force decay with a time constant of {found.time:.2f} s"
        f" (standard deviations {100 * found.fraction_deviation:.1f} % and {found.time_deviation:.2f} s;"
        f" holds: {found.holds})"
    )
    if found.left > UNFIT:
        line += f"; one time constant leaves {100 * found.left:.0f} % of the force unexplained"
    return found, line


def term_of(hold: Hold, elastic: Floats) -> Relaxation:
    """Return how the force relaxes in one hold, whatever its noise; elastic: as of `relaxation_of`."""
    return _fitted([_thinned(hold, elastic)])


def _thinned(hold: Hold, elastic: Floats) -> _Thinned:
    """Return a hold with few samples: equally long while it enters, and ever longer in the hold."""
    first = hold.length * 1e-3
    edges = np.concatenate(
        [
            np.linspace(min(float(hold.time[0]), -1e-9), 0.0, WAY_IN + 1)[:-1],
            [0.0],
            np.geomspace(first, hold.length, HELD),
        ]
    )
    group = np.searchsorted(edges, hold.time, side="right")
    count = np.bincount(group).astype(np.float64)
    known = count > 0.0

    def mean(values: Floats) -> Floats:
        return np.asarray(np.bincount(group, values)[known] / count[known])

    return _Thinned(mean(hold.time), mean(hold.forces), mean(elastic), count[known])


def relaxed(time: Floats, elastic: Floats, fraction: float, constant: float) -> Floats:
    """Return the force (k,) N of tissue that relaxes, from the elastic one (k,) N.

    Parameters
    ----------
    time : Floats, shape (k,), s
        Times.
    elastic : Floats, shape (k,), N
        Elastic force, linear between the times.
    fraction : float
        Fraction that decays.
    constant : float, s
        Time constant.
    """
    step = np.maximum(np.diff(time), 1e-12)
    fade = np.exp(-step / constant)
    gain = np.diff(elastic) * constant / step * (1.0 - fade)
    lasting = np.empty_like(elastic)
    lasting[0] = elastic[0]
    for row in range(len(step)):
        lasting[row + 1] = fade[row] * lasting[row] + gain[row]
    return np.asarray((1.0 - fraction) * elastic + fraction * lasting)


def _residuals(some: Sequence[_Thinned], fraction: float, constant: float) -> list[Floats]:
    """Return residuals of each hold relative to its largest force, with the factor that fits best."""
    found = []
    for one in some:
        model = relaxed(one.time, one.elastic, fraction, constant)
        factor = (one.averaged * model) @ one.force / max(float((one.averaged * model) @ model), 1e-300)
        scale = max(float(one.force.max()), 1e-12)
        found.append(np.sqrt(one.averaged) * (one.force - factor * model) / scale)
    return found


def _fitted(some: Sequence[_Thinned]) -> Relaxation:
    """Return the fraction and the time constant that holds have in common."""
    longest = max(float(one.time[-1]) for one in some)
    starts = np.log(np.geomspace(longest / 50.0, longest, STARTS))
    limits = ([-0.5, np.log(longest / 2000.0)], [0.99, np.log(20.0 * longest)])

    def off(unknown: Floats) -> Floats:
        return np.concatenate(_residuals(some, float(unknown[0]), float(np.exp(unknown[1]))))

    tried = [least_squares(off, [0.2, start], bounds=limits) for start in starts]
    best = min(tried, key=lambda one: float(one.cost))
    fraction, constant = float(best.x[0]), float(np.exp(best.x[1]))
    residuals = _residuals(some, fraction, constant)
    again = max(_correlation(one) for one in residuals)
    square = 2.0 * float(best.cost) / max(len(best.fun) - 2 - len(some), 1) * (1.0 + again) / (1.0 - again)
    deviation = np.sqrt(square * np.diag(np.linalg.pinv(best.jac.T @ best.jac)))
    if len(some) > 2:  # holds that differ show more than their noise
        alone = np.array([[found.fraction, np.log(found.time)] for found in (_fitted([one]) for one in some)])
        deviation = np.maximum(deviation, alone.std(axis=0, ddof=1) / np.sqrt(len(some)))
    total = sum(float(one.averaged.sum()) for one in some)
    left = float(np.sqrt(sum(float(one @ one) for one in residuals) / total))
    return Relaxation(fraction, constant, float(deviation[0]), constant * float(deviation[1]), len(some), left)


def _correlation(residuals: Floats) -> float:
    """Return the correlation of neighbouring residuals, between 0 and 0.95."""
    if len(residuals) < 3 or np.std(residuals) == 0.0:
        return 0.0
    return float(np.clip(np.corrcoef(residuals[1:], residuals[:-1])[0, 1], 0.0, 0.95))
