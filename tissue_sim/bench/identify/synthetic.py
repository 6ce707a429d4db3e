"""Presses made by this package's finite elements, with a modulus that is known: what the identification finds of it."""

from __future__ import annotations

import hashlib
from typing import NamedTuple

import numpy as np

from tissue_sim import progress
from tissue_sim.array_types import Floats, Longs
from tissue_sim.bench import rows
from tissue_sim.bench.identify.known_presses import DEEP, FINGER, forces_by_elements
from tissue_sim.calibration.checkpoint import Checkpoint
from tissue_sim.identification.force_curves import ForceCurves, tabulated
from tissue_sim.identification.measured import MeasuredPress, Measurement, Samples
from tissue_sim.identification.mixed_effects import Fit, Priors, fitted
from tissue_sim.identification.places import PressPoint, flat_locations
from tissue_sim.identification.press_curves import Arrays, curves_of
from tissue_sim.identification.pressing import FRICTION
from tissue_sim.identification.uncertainty import Interval, drawn_factors, interval_of, model_error
from tissue_sim.json_types import JsonObject
from tissue_sim.organ.organ import Organ
from tissue_sim.result_cache import remembered, user_cache
from tissue_sim.version import __version__

MODULUS = 6300.0  # Pa
DEPTHS = np.concatenate([np.linspace(-8e-4, -1e-4, 5), np.linspace(1e-4, 0.0038, 20)])  # m, of samples
KNOTS = 10  # depths at which the model is held
PLACES, USED = 8, 6  # pressed by finite elements; drawn for each run
RUNS = 100
NOISE, FRACTION = 0.005, 0.02  # N and of the force
BIAS, OFFSET = 0.01, 2e-4  # N and m
CASES = {
    "noise": (0.0, 0.0, Priors(offset=2e-5)),
    "noise and bias": (BIAS, 0.0, Priors(offset=2e-5)),
    "noise, bias and unknown offsets": (BIAS, OFFSET, Priors(offset=OFFSET)),
    "the same, offsets ignored": (BIAS, OFFSET, Priors(offset=1e-6)),
}


class Truth(NamedTuple):
    """Curves of finite elements with the known modulus, and of the model, at the same places."""

    elements: ForceCurves
    model: ForceCurves
    modulus: float
    own_error: float


class Recovered(NamedTuple):
    """Result of a case: found moduli (r,) Pa, and how many intervals hold the truth."""

    name: str
    moduli: Floats
    held: int
    width: float

    @property
    def off(self) -> Floats:
        """Error of each run, %."""
        return np.asarray(100.0 * (self.moduli / MODULUS - 1.0))


def truth_of(organ: Organ) -> Truth:
    """Return both sets of curves; those of finite elements, which take minutes, are kept in the user's cache."""
    spots = [one[number % len(one)] for number, one in enumerate(flat_locations(organ, PLACES))]

    solved = forces_by_elements(organ, spots, "identify-presses")
    settled = np.isfinite(solved).all(axis=1)
    known = [spot for spot, is_settled in zip(spots, settled, strict=True) if is_settled]
    model = model_curves(organ, known)
    return Truth(elements_of(organ, solved[settled]), model, organ.youngs_modulus, model_error(organ, FINGER))


def elements_of(organ: Organ, solved: Floats) -> ForceCurves:
    """Return the curves of finite elements for the known modulus, from forces (n, d) N for the organ's own."""
    scale = MODULUS / organ.youngs_modulus
    return tabulated(
        [np.concatenate([[0.0], DEEP])] * len(solved),
        [np.concatenate([[0.0], scale * one]) for one in solved],
        np.arange(len(solved)),
    )


def model_curves(organ: Organ, spots: list[PressPoint]) -> ForceCurves:
    """Return the model's curves at spots; they take minutes, and are kept in the user's cache, each as it comes."""
    presses = [
        MeasuredPress("", DEPTHS, DEPTHS, spot.point - FINGER * spot.direction, spot.direction, np.zeros((0, 3)))
        for spot in spots
    ]
    measurement = Measurement("", FINGER, presses, [], [], True)
    key = hashlib.sha256(f"{organ.digest()} {measurement.points.tolist()} {__version__}".encode()).hexdigest()

    def make() -> Arrays:
        kept = Checkpoint(user_cache() / f".identify-curves-{key[:24]}", {"key": key})
        curves = curves_of(organ, measurement, FRICTION, 1.0, kept.remember, KNOTS)
        kept.remove()
        return {"start": curves.start, "step": curves.step, "force": curves.force, "which": curves.which}

    return ForceCurves(**remembered("identify-curves", key, make))


def measure(organ: Organ, runs: int = RUNS) -> list[Recovered]:
    """Return what is found in runs of each case."""
    truth = truth_of(organ)
    found: list[Recovered] = []
    with rows.until_stopped():
        for number, name in enumerate(CASES):
            found.append(recovered(name, truth, np.random.default_rng(number), runs))
            rows.report(
                name, f"error {np.abs(found[-1].off).max():.1f} %", f"{found[-1].held} of {runs} intervals hold"
            )
    return found


def recovered(name: str, truth: Truth, random: np.random.Generator, runs: int = RUNS) -> Recovered:
    """Return what is found in runs of one case: each has other places, noise and offsets."""
    bias, offset, priors = CASES[name]
    count = len(truth.elements.which)
    moduli, held, widths = np.empty(runs), 0, []
    for run in progress.steps(range(runs), name):
        chosen = np.sort(random.permutation(count)[: min(USED, count)])
        samples, curves = pressed(truth.elements.some(chosen), bias, offset, random), truth.model.some(chosen)
        fit, interval = identified(samples, curves, priors, truth.own_error, run)
        moduli[run] = fit.factor * truth.modulus
        held += bool(interval.low * truth.modulus < MODULUS < interval.high * truth.modulus)
        widths.append(0.5 * np.log(interval.high / interval.low))
    return Recovered(name, moduli, held, float(np.median(widths)))


def pressed(elements: ForceCurves, bias: float, offset: float, random: np.random.Generator) -> Samples:
    """Return samples of presses by finite elements with noise, a bias, N, and contact offsets, m."""
    depths = np.tile(DEPTHS, (len(elements.which), 1))
    force = elements.at(depths + offset * random.normal(size=(len(depths), 1)))[0] + bias
    force = force * (1.0 + FRACTION * random.normal(size=force.shape)) + NOISE * random.normal(size=force.shape)
    return Samples(depths, force, np.ones_like(force))


def identified(
    samples: Samples, curves: ForceCurves, priors: Priors, own_error: float, seed: int, place: Longs | None = None
) -> tuple[Fit, Interval]:
    """Return the fit of presses and the interval of its factor, as an identification computes them.

    place: of each press, (n,); None where each has its own.
    """
    fit = fitted(curves, samples, priors)
    place = np.arange(len(samples.depths)) if place is None else place
    drawn = drawn_factors(curves, samples, priors, fit, place, seed)
    return fit, interval_of(fit, drawn, int(place.max()) + 1, own_error)


def as_rows(found: list[Recovered]) -> list[JsonObject]:
    """Return all figures, as JSON can hold them."""
    return [
        {
            "case": one.name,
            "runs": len(one.moduli),
            "mean_pa": float(one.moduli.mean()),
            "deviation_pa": float(one.moduli.std()),
            "median_error_percent": float(np.median(np.abs(one.off))),
            "p90_error_percent": float(np.quantile(np.abs(one.off), 0.9)),
            "intervals_that_hold": one.held,
            "half_width_percent": 100.0 * one.width,
        }
        for one in found
    ]
