"""Measured presses of phantoms, meat and liver, with one modulus and with a map, beside Hertz and linear elasticity.

The data are of others: github.com/vu-arma-dev/robot-palpation-data, commit 13aef0c (ICRA 2016; RA-L 2017, 2018), as CSV
files. Neither the thickness nor the support of what was pressed is known, nor a Young's modulus, so that what counts is
how well forces at places that were not fitted are predicted.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from tissue_sim.bench import rows
from tissue_sim.errors import UserError
from tissue_sim.identification.diagnosis import Diagnosis, diagnosed
from tissue_sim.identification.force_curves import ForceCurves, bonded_layer, hertz, tabulated
from tissue_sim.identification.measured import MeasuredPress, Measurement, relative_errors, samples_of
from tissue_sim.identification.mixed_effects import Priors, fitted
from tissue_sim.identification.press_curves import REACH, curves_of
from tissue_sim.identification.slab import cached_slab
from tissue_sim.identification.table import presses_of, read_columns
from tissue_sim.identification.validation import HeldOut, held_out
from tissue_sim.json_types import JsonObject
from tissue_sim.organ.organ import Organ

SLAB = (0.06, 0.06, 0.025)  # m
FRICTION = 0.6
# Contact was where a force of 0.05 or 0.08 N was first measured, which a robot finds again within hundredths of a mm.
PRIORS = Priors(offset=5e-5)
BALLS = {"liver": 4e-3, "phantom": 3.16e-3, "meat": 3.16e-3}  # m, radius
SETS = {
    "whole_region_model_v2": "phantom",
    "probingRAL2018_T1": "phantom",
    "probingRAL2018_T2": "phantom",
    "meat0904_region4": "meat",
    "meat0904_overlap_region4": "meat",
    "meat20150903_region1": "meat",
    "pig_liver_20150826_region1": "liver",
    "pig_liver_20150826_region4": "liver",
    "pig_liver_20150826_v2_region1": "liver",
    "pig_liver_20150826_v2_region2": "liver",
    "pig_liver_20150826_v2_region4": "liver",
}
LAWS = ("model", "hertz", "linear")
TWICE = "probingRAL2018_T1", "probingRAL2018_T2"  # the same places, pressed twice
SAME = 5e-4  # m between them


class SetErrors(NamedTuple):
    """Result of a set: modulus Pa of the model's fit, and held-out errors by law."""

    name: str
    kind: str
    presses: int
    modulus: float
    errors: dict[str, HeldOut]
    diagnosis: Diagnosis


def check_data(folder: Path) -> None:
    """Raise UserError where a folder lacks a set."""
    for name in SETS:
        if not (folder / f"{name}.csv").is_file():
            raise UserError(f"{folder / name}.csv does not exist; name the folder of the measured tables with --data")


def measure(folder: Path, slab: Organ | None = None) -> list[SetErrors]:
    """Return the result of every set; slab: None for the usual one. Raises UserError for tables that are damaged."""
    organ = cached_slab(SLAB) if slab is None else slab
    thickness = float(np.ptp(organ.surface_positions[:, 2]))
    model: dict[float, ForceCurves] = {}
    found = []
    with rows.until_stopped():
        for name, kind in rows.each(SETS.items(), "sets"):
            radius = BALLS[kind]
            presses = presses_of(read_columns(folder / f"{name}.csv"), radius, name)
            deepest = max(press.deepest for press in presses)
            if radius not in model or _end(model[radius]) < deepest:
                model[radius] = _model_curve(organ, radius, presses)
            curves = {"model": model[radius]._replace(which=np.zeros(len(presses), dtype=np.int64))}
            given = radius, organ.youngs_modulus, organ.poisson_ratio, deepest + REACH
            curves["hertz"] = _shared(*hertz(*given), len(presses))
            curves["linear"] = _shared(*bonded_layer(*given, thickness), len(presses))
            found.append(errors_of(name, presses, curves, organ.youngs_modulus))
            one = found[-1].errors["model"]
            rows.report(name, f"{100 * one.one:.1f} % with one modulus", f"{100 * one.mapped:.1f} % with a map")
    return found


def repeat_errors(folder: Path) -> list[float]:
    """Return the errors of taking one measurement of a place for the other, both ways: what no prediction can beat far.

    Raises UserError for tables that are damaged.
    """
    radius = BALLS["phantom"]
    both = [presses_of(read_columns(folder / f"{name}.csv"), radius, name) for name in TWICE]
    found = []
    for known, wanted in (both, both[::-1]):
        apart, index = cKDTree([press.place for press in known]).query([press.place for press in wanted])
        same = np.flatnonzero(apart < SAME)
        samples = samples_of([wanted[row] for row in same])
        pairs = zip(samples.depths, (known[row] for row in index[same]), strict=True)
        # Beyond the depths of one measurement it says nothing of the other.
        predicted = np.array([np.interp(depths, press.depths, press.forces, right=np.nan) for depths, press in pairs])
        found.append(float(np.nanmedian(relative_errors(samples, predicted))))
    return found


def errors_of(name: str, presses: list[MeasuredPress], curves: dict[str, ForceCurves], modulus: float) -> SetErrors:
    """Return the errors of a set by law; curves of all presses by law, for a modulus, Pa."""
    radius = BALLS[SETS[name]]
    samples = samples_of(presses)
    points = np.array([press.place + radius * press.direction for press in presses])
    errors = {}
    for law, own in curves.items():
        errors[law] = held_out(own, samples, points, radius, PRIORS)
    fit = fitted(curves["model"], samples, PRIORS)
    known = {law: one for law, one in errors.items() if one is not None}
    return SetErrors(
        name,
        SETS[name],
        len(presses),
        modulus * fit.factor,
        known,
        diagnosed(curves["model"], samples, PRIORS, fit),
    )


def _model_curve(organ: Organ, radius: float, presses: list[MeasuredPress]) -> ForceCurves:
    return curves_of(organ, Measurement("", radius, presses, [], [], False), FRICTION)


def _end(curves: ForceCurves) -> float:
    return float(curves.start[0] + curves.step[0] * (curves.force.shape[1] - 1))


def _shared(depth: np.ndarray, force: np.ndarray, count: int) -> ForceCurves:
    return tabulated([depth], [force], np.zeros(count, dtype=np.int64))


def as_rows(found: list[SetErrors]) -> list[JsonObject]:
    """Return all figures, as JSON can hold them."""
    return [
        {
            "set": one.name,
            "kind": one.kind,
            "presses": one.presses,
            "modulus_pa": one.modulus,
            "errors_percent": {
                law: {"one_modulus": 100.0 * errors.one, "map": 100.0 * errors.mapped}
                for law, errors in one.errors.items()
            },
            "exponent": one.diagnosis.exponent,
            "model_exponent": one.diagnosis.model_exponent,
            "stiffens": one.diagnosis.stiffens,
            "holds_to_mm": 1e3 * one.diagnosis.holds_to,
        }
        for one in found
    ]
