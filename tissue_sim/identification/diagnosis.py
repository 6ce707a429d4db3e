"""What a model with one modulus can't say: residuals against depth, and the exponent of the force."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tissue_sim.array_types import Floats
from tissue_sim.identification.force_curves import ForceCurves
from tissue_sim.identification.measured import LEAST_FORCE, Samples
from tissue_sim.identification.mixed_effects import FRACTION, NOISE, Fit, Priors, fitted

BINS = 6
STIFFER = 0.3  # of the exponent above the model's, from which support or law are wrong
WELL = 0.10  # median error at a depth up to which the fit holds
EXPONENTS = np.linspace(0.6, 5.0, 45)
OFFSETS = np.linspace(-1.5e-3, 1.5e-3, 61)  # m
FREE = -4e-4  # m, before which a tool doesn't touch


class Diagnosis(NamedTuple):
    """Residuals and exponents.

    Attributes
    ----------
    depths : Floats, shape (b,), m
        Upper ends of classes of depths.
    residuals : Floats, shape (b,)
        Median of measured over fitted force less 1 in each, each press with its own offset and modulus.
    exponent, model_exponent : float
        Exponents of depth to which measured and fitted forces are proportional, medians of the presses.
    holds_to : float, m
        Depth up to which a fit of the samples up to there is within 10 % there, in the median; 0 for none.
    """

    depths: Floats
    residuals: Floats
    exponent: float
    model_exponent: float
    holds_to: float

    @property
    def stiffens(self) -> bool:
        """Whether tissue stiffens with depth more than the model can."""
        return self.exponent - self.model_exponent > STIFFER


def diagnosed(curves: ForceCurves, samples: Samples, priors: Priors, fit: Fit) -> Diagnosis:
    """Return what a fit leaves unexplained.

    Parameters
    ----------
    curves : ForceCurves
        The model's curves.
    samples : Samples
        The measured forces.
    priors : Priors
        As for `fitted`.
    fit : Fit
        Its result.

    Returns
    -------
    Diagnosis
        Residuals and exponents.
    """
    deepest = float(samples.depths[samples.counts > 0.0].max())
    ends = np.linspace(0.0, deepest, BINS + 1)[1:]
    predicted = fit.predicted(curves, samples, fit.own)
    residuals = np.array([_residual(samples, predicted, end, end - ends[0]) for end in ends])
    free = (samples.counts > 0.0) & (samples.depths < FREE)
    bias = float(np.median(samples.forces[free])) if free.any() else 0.0  # the fitted one hides what the law lacks
    measured = exponent_of(samples._replace(forces=samples.forces - bias))
    modelled = exponent_of(samples._replace(forces=predicted - fit.common[2]))
    holds = 0.0
    for end in ends[::-1]:
        some = samples.up_to(float(end))
        shallow = fitted(curves, some, priors)
        if abs(_residual(some, shallow.predicted(curves, some, shallow.own), end, end - ends[0], True)) <= WELL:
            holds = float(end)
            break
    return Diagnosis(ends, residuals, measured, modelled, holds)


def _residual(samples: Samples, predicted: Floats, end: float, begin: float, absolute: bool = False) -> float:
    """Return the median relative residual between two depths, m; NaN where there is no sample."""
    own = (samples.counts > 0.0) & (samples.depths > begin) & (samples.depths <= end)
    off = (samples.forces - predicted)[own] / np.maximum(np.abs(predicted[own]), LEAST_FORCE)
    return float(np.median(np.abs(off) if absolute else off)) if own.any() else np.nan


def exponent_of(samples: Samples) -> float:
    """Return the exponent of depth to which forces are proportional, the median of presses.

    Each press has an amplitude, an exponent and an offset of its own, which are found on a grid.

    Parameters
    ----------
    samples : Samples
        Forces without bias.
    """
    weight = samples.counts / (NOISE + FRACTION * np.abs(samples.forces)) ** 2
    whole = (weight * samples.forces**2).sum(axis=1)
    best, found = np.full(len(whole), np.inf), np.ones(len(whole))
    for shift in OFFSETS:
        deep = np.log(np.maximum(samples.depths + shift, 1e-7) / 1e-3)
        for exponent in EXPONENTS:
            shape = np.where(samples.depths + shift > 0.0, np.exp(exponent * deep), 0.0)
            along = (weight * shape * samples.forces).sum(axis=1)
            size = np.maximum((weight * shape**2).sum(axis=1), 1e-300)
            cost = whole - np.maximum(along, 0.0) ** 2 / size
            better = cost < best
            best[better], found[better] = cost[better], exponent
    return float(np.median(found))
