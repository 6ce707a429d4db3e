"""Fit of a modulus to presses whose contact and tissue differ a little from place to place.

A nonlinear model with mixed effects (Lindstrom and Bates, Biometrics 46, 1990). The force of press i at depth d is `s
exp(v_i) C_i(d + o + w_i) + b`: C_i is the model's force for its own modulus, s the factor on that modulus, o the
contact offset that all presses share, b the sensor's bias; v_i and w_i are the deviations of a press. w_i is normal
with a given spread. v_i has Student's t distribution with an unknown spread, so that places that differ a lot, such as
those over a tumour, hardly change s (Lange, Little and Taylor, JASA 84, 1989). Gauss-Newton steps in which each press's
own unknowns are eliminated alternate with steps of expectation and maximisation for the spread and the noise. Where the
curves have numbers of the tissue's law, these are further common unknowns, and stay between 0 and 1.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tissue_sim.array_types import Floats
from tissue_sim.identification.force_curves import Curves
from tissue_sim.identification.measured import Samples

FREEDOM = 3.0  # of Student's t
VAGUE = 3.0  # spread of the log factor about the first guess
COMMON_OFFSET = 1e-3  # m, spread of what all contacts may be off by together
NOISE, FRACTION = 0.002, 0.02  # N and of the force: shape of the noise, whose size is fitted
SPREAD, PRIOR = 0.1, 2.0  # of log moduli between places before anything is known, and its weight in presses
LEAST_SPREAD = 0.005
ROUNDS, AGAIN = 60, 25  # of the fit, and of one that starts from a fit
FARTHEST = np.array([0.5, 2e-4, 0.02])  # of a step: log modulus, offset m, bias N
LAW = 3  # common unknown from which on they are numbers of the law
FARTHEST_LAW = 0.2  # of a step of these


class Priors(NamedTuple):
    """Spread of the contact offset between presses, m, and of the sensor's bias, N."""

    offset: float = 2e-4
    bias: float = 0.02


class Fit(NamedTuple):
    """Result of a fit.

    Attributes
    ----------
    common : Floats, shape (3 + k,)
        Log of the factor on the modulus, contact offset m, bias N, and the k numbers of the law that were fitted.
    own : Floats, shape (n, 2)
        Deviation of each press: log of the factor, offset m.
    spread : float
        Spread of the log moduli between places.
    noise : float
        Factor on the noise's shape.
    covariance : Floats, shape (3 + k, 3 + k)
        Of the common unknowns.
    """

    common: Floats
    own: Floats
    spread: float
    noise: float
    covariance: Floats

    @property
    def factor(self) -> float:
        """Factor on the modulus of the curves."""
        return float(np.exp(self.common[0]))

    @property
    def law(self) -> Floats:
        """The numbers of the law, (k,)."""
        return self.common[LAW:]

    def predicted(self, curves: Curves, samples: Samples, own: Floats | None = None) -> Floats:
        """Return the forces (n, d) N at the samples' depths; own: deviations (n, 2), none if left out."""
        deviation = np.zeros((len(samples.depths), 2)) if own is None else own
        force, _ = curves.under(self.law).at(samples.depths + self.common[1] + deviation[:, 1:])
        return np.asarray(np.exp(self.common[0] + deviation[:, :1]) * force + self.common[2])


class _Linear(NamedTuple):
    """Normal equations about a state, press by press."""

    residual: Floats  # (n, d) N
    weight: Floats  # (n, d) 1/N^2
    common: Floats  # (n, 3 + k, 3 + k)
    mixed: Floats  # (n, 3 + k, 2)
    own: Floats  # (n, 2, 2)
    right: Floats  # (n, 3 + k)
    right_own: Floats  # (n, 2)


def fitted(
    curves: Curves,
    samples: Samples,
    priors: Priors,
    start: Fit | None = None,
    times: Floats | None = None,
) -> Fit:
    """Return the fit of a factor on the modulus to presses.

    Parameters
    ----------
    curves : Curves
        The model's curve for each press.
    samples : Samples
        The measured forces.
    priors : Priors
        Spread of contact and bias.
    start : Fit | None, optional
        Fit of the same presses to start from.
    times : Floats | None, optional
        How often each press counts, (n,), for a bootstrap.
    """
    count = np.ones(len(samples.depths)) if times is None else times
    middle = np.array([_first_guess(curves, samples), 0.0, 0.0, *[0.0] * curves.laws])
    common = middle if start is None else start.common.copy()
    own = np.zeros((len(count), 2)) if start is None else start.own.copy()
    spread, noise = (SPREAD, 1.0) if start is None else (start.spread, start.noise)
    typical = np.ones(len(count))  # weight of each press in Student's t
    own_inverse = np.zeros((len(count), 2, 2))
    schur = np.eye(len(middle))
    prior = np.array([VAGUE, COMMON_OFFSET, priors.bias, *[VAGUE] * curves.laws]) ** -2
    for round_ in range(ROUNDS if start is None else AGAIN):
        now = _linear(curves, samples, common, own, noise)
        precision = np.stack([typical / spread**2, np.full(len(count), priors.offset**-2)], axis=1)
        own_inverse = np.linalg.inv(now.own + precision[:, :, None] * np.eye(2))
        left_own = now.right_own - own * precision
        carried = now.mixed @ own_inverse
        schur = np.einsum("n,nkl->kl", count, now.common - carried @ np.swapaxes(now.mixed, 1, 2))
        right = np.einsum("n,nk->k", count, now.right - np.einsum("nkl,nl->nk", carried, left_own))
        schur = schur + np.diag(prior)
        step = _step(schur, right - prior * (common - middle), common)
        behind = left_own - np.einsum("nkl,k->nl", now.mixed, step)
        own_step = np.einsum("nkl,nl->nk", own_inverse, behind)
        common = common + step
        own = own + np.clip(own_step, -FARTHEST[:2], FARTHEST[:2])
        if round_ < 3:
            continue
        spread, typical = _spread_of(own[:, 0] ** 2 + own_inverse[:, 0, 0], spread, count)
        used = np.einsum("nkl,nlk->n", now.own, own_inverse)
        free = np.maximum(samples.counts.sum(axis=1) - used, 0.1)
        noise *= float(np.sqrt(count @ (now.weight * now.residual**2).sum(axis=1) / (count @ free)))
        noise = max(noise, 1e-3)
        if start is not None and abs(step[0]) < 1e-5 and round_ > 6:
            break
    return Fit(common, own, spread, noise, np.linalg.inv(schur))


def _step(matrix: Floats, right: Floats, common: Floats) -> Floats:
    """Return a step of the common unknowns; those of the law stay between 0 and 1."""
    step = np.linalg.solve(matrix, right)
    law = np.clip(np.clip(step[LAW:], -FARTHEST_LAW, FARTHEST_LAW), -common[LAW:], 1.0 - common[LAW:])
    if (law != step[LAW:]).any():  # the others go where they belong with it
        step = np.concatenate([np.linalg.solve(matrix[:LAW, :LAW], right[:LAW] - matrix[:LAW, LAW:] @ law), law])
    step[:LAW] = np.clip(step[:LAW], -FARTHEST, FARTHEST)
    return step


def _spread_of(square: Floats, spread: float, count: Floats) -> tuple[float, Floats]:
    """Return the spread of log moduli, and each press's weight, for expected squares (n,) and counts (n,)."""
    typical = (FREEDOM + 1.0) / (FREEDOM + square / spread**2)
    found = (count @ (typical * square) + PRIOR * SPREAD**2) / (count.sum() + PRIOR)
    return max(float(np.sqrt(found)), LEAST_SPREAD), typical


def _first_guess(curves: Curves, samples: Samples) -> float:
    """Return the log of the factor by which the deepest forces exceed the model's, in the median."""
    deepest = np.where(samples.counts > 0.0, samples.depths, -np.inf).argmax(axis=1)[:, None]
    force, _ = curves.under(np.zeros(curves.laws)).at(np.take_along_axis(samples.depths, deepest, axis=1))
    measured = np.take_along_axis(samples.forces, deepest, axis=1)
    both = (force > 0.0) & (measured > 0.0)
    return float(np.log(np.median(measured[both] / force[both]))) if both.any() else 0.0


def _linear(curves: Curves, samples: Samples, common: Floats, own: Floats, noise: float) -> _Linear:
    """Return the normal equations about a state."""
    depths = samples.depths + common[1] + own[:, 1:]
    force, slope = curves.under(common[LAW:]).at(depths)
    factor = np.exp(common[0] + own[:, :1])
    model, slope = factor * force, factor * slope
    scale = NOISE + FRACTION * model
    weight = samples.counts / (noise * scale) ** 2
    residual = samples.forces - model - common[2]
    by_law = [factor * change.at(depths)[0] for change in curves.changes(common[LAW:])]
    moved = np.stack([model, slope, np.ones_like(model), *by_law], axis=2)
    weighted = moved * weight[:, :, None]
    whole = np.swapaxes(weighted, 1, 2) @ moved
    right = np.einsum("ndk,nd->nk", weighted, residual)
    return _Linear(residual, weight, whole, whole[:, :, :2], whole[:, :2, :2], right, right[:, :2])
