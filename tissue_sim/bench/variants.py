"""Organs that are compared at one size: as the pipeline makes it, and calibrated.

All sizes are fitted to one finite-element body, the reference's, under the same loads: one clamp, material and shape.
"""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Callable, Sequence
from functools import lru_cache, partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tissue_sim import progress
from tissue_sim.array_types import Array, Floats
from tissue_sim.bench.sizes import Sized, at_size, sized
from tissue_sim.bench.surface_field import answers
from tissue_sim.calibration.cases import fit_cases, principal
from tissue_sim.calibration.cohort import spread
from tissue_sim.calibration.dynamics import lowest_frequencies
from tissue_sim.calibration.elastic import Elastic
from tissue_sim.calibration.fem import Body
from tissue_sim.calibration.fit import Misfit, fit
from tissue_sim.calibration.groups import group_of, search
from tissue_sim.calibration.inertia import MODES, damping_rate, fit_mass, frequencies_of
from tissue_sim.calibration.joint_fit import fit_together, for_one_substep
from tissue_sim.calibration.reference import corrected, finer_reference_body, samples_of
from tissue_sim.calibration.stiffness import (
    INTERIOR_FRACTION,
    ONE_STEP,
    Settings,
    first_stiffness,
    prepared,
    with_stiffness,
)
from tissue_sim.calibration.tissue_fit import CELL_BOUNDS
from tissue_sim.errors import UserError
from tissue_sim.model.elasticity.assembly import assemble
from tissue_sim.organ.organ import Organ
from tissue_sim.result_cache import remembered

SEED = 0  # of the fit's cases
BALANCED = Settings().aim
GROUPS = "groups"
MORE_MODES = 20  # whose frequencies are compared; masses are fitted to the lowest MODES
SAMPLED = 300  # loads, some of which determine where the finer mesh is fine
_VERSION = "10"  # version of what is cached
_MISSING = "not fitted yet"


class Effort(NamedTuple):
    """Effort of a fit at some size: linear load cases, and evaluations of the misfit."""

    cases: int
    steps: int


class Fit(NamedTuple):
    """Calibration that a size needs."""

    reference: Organ  # whose finite-element body answers
    organ: Organ  # that is fitted
    kind: str  # groups, or what cells are for


class Variants(NamedTuple):
    """Organs of one size.

    Attributes
    ----------
    plain : Organ
        As the pipeline makes it.
    groups : Organ | str
        Calibrated by groups of springs, or the reason why it is missing.
    cells : dict[str, Organ | str]
        Calibrated cell by cell, by aim as `tissue_sim calibrate --for` has it, or the reason why one is missing.
    """

    plain: Organ
    groups: Organ | str
    cells: dict[str, Organ | str]


def effort_at(points: int) -> Effort:
    """Return the effort with which a fit takes minutes at any size; the organ's own calibration has more."""
    if points <= 1000:
        return Effort(1200, 90)
    if points <= 2500:
        return Effort(600, 60)
    return Effort(600, 45) if points <= 5000 else Effort(300, 30)


def variants_of(body: Body, points: int, *, fits: bool, every_aim: bool = False) -> Variants:
    """Return the organs of one size of the organ of a finite-element body.

    points: number of surface points; fits: whether missing calibrations are made, which takes minutes each, once
    (springs are fitted by groups at the organ's own size alone); every_aim: whether cells are also fitted for speed and
    for accuracy.
    """
    organ = body.organ
    plain = at_size(organ, points)
    own = points == organ.n_surface
    if not fits:
        missing = "the organ is not calibrated; calibrate it with 'tissue_sim calibrate ORGAN --out ORGAN2'"
        return Variants(
            plain, "takes minutes to fit, excluded by --quick", {BALANCED: organ if _ready(organ, own) else missing}
        )
    made = {
        fit.kind: _kept(fit, lambda fit: fitted(body, fit.organ, fit.kind, effort_at(points)))
        for fit in fits_of(organ, plain, every_aim)
    }
    springs = made.pop(GROUPS, "fitted at the organ's own size only")
    return Variants(plain, springs, {BALANCED: organ, **made} if _ready(organ, own) else made)


def fits_of(organ: Organ, plain: Organ, every_aim: bool) -> list[Fit]:
    """Return the fits that variants of a size need; plain: the organ of that size as the pipeline makes it."""
    own = plain.n_surface == organ.n_surface
    aims = INTERIOR_FRACTION if every_aim else (BALANCED,)
    found = [
        Fit(organ, prepared(plain, Settings(aim=aim)), aim)
        for aim in aims
        if not (aim == BALANCED and _ready(organ, own))
    ]
    return [*found, Fit(organ, plain, GROUPS)] if own else found


def fit_on_cluster(organ: Organ, points: Sequence[int], scheduler: str) -> None:
    """Let a Dask cluster make the fits of several sizes that are not kept yet.

    points: numbers of surface points; scheduler: address of the scheduler. Raises UserError where the scheduler doesn't
    answer. What fails there is tried again, and reported, where it is used.
    """

    def missing(_: Fit) -> dict[str, Array]:
        raise UserError(_MISSING)

    fits = [fit for count in points for fit in fits_of(organ, at_size(organ, count), count == organ.n_surface)]
    fits = [fit for fit in fits if _kept(fit, missing) == _MISSING]
    for number, made in spread(made_alone, fits, scheduler=scheduler):
        if not isinstance(made, UserError):
            _kept(fits[number], partial(_given, made))


def _given(made: dict[str, NDArray], _: Fit) -> dict[str, NDArray]:
    return made


def made_alone(fit: Fit) -> dict[str, NDArray]:
    """Return a fit with a body of its own."""
    return fitted(Body(fit.reference), fit.organ, fit.kind, effort_at(fit.organ.n_surface))


def _ready(organ: Organ, own: bool) -> bool:
    """Return whether the organ itself is the calibrated one of its own size."""
    return own and is_calibrated(organ)


def is_calibrated(organ: Organ) -> bool:
    """Return whether every cell of an organ was fitted."""
    figures = organ.provenance.get("calibration")
    return isinstance(figures, dict) and figures.get("method") == "cells"


def _kept(fit: Fit, make: Callable[[Fit], dict[str, NDArray]]) -> Organ | str:
    """Return the organ calibrated, from the user's cache when it was done before; the reason when it can't be."""
    effort = effort_at(fit.organ.n_surface)
    source = f"{_VERSION} {SEED} {tuple(effort)} {fit.reference.digest()} {fit.organ.digest()}"
    key = hashlib.sha256(source.encode()).hexdigest()
    try:
        made = remembered(f"calibrated-{fit.kind}", key, lambda: make(fit))
    except UserError as error:
        return str(error)
    lowest, next_ones = 100.0 * made["modes_off"]
    text = f"{fit.kind}: {effort.cases} linear loads, {effort.steps} evaluations; the error of modes 1 to {MODES}"
    text += f" is at most {lowest:.1f} %, of {MODES + 1} to {MORE_MODES} at most {next_ones:.1f} %"
    values: dict[str, Any] = {name: value for name, value in made.items() if name != "modes_off"}
    return dataclasses.replace(fit.organ, provenance={**fit.organ.provenance, "fit": text}, **values)


def fitted(body: Body, organ: Organ, kind: str, effort: Effort) -> dict[str, NDArray]:
    """Return stiffnesses, masses and damping of an organ, by its names for them, fitted to a body's linear answers.

    Also modes_off (2,): the largest error of the frequencies to which the masses are fitted, and of the following ones.
    body: the reference's, whose surface may be another one of the same body; kind: `groups`, one factor for each group
    of springs, as in the paper; or every cell, for `fast`, ... Raises UserError when a part of the organ is free to
    move.
    """
    pushes = fit_cases(body.organ, effort.cases, SEED)
    size = sized(organ, body.organ)
    model = assemble(organ)
    elastic, start = Elastic(model), first_stiffness(organ, model)
    misfit = _misfit(elastic, body, size, pushes)
    with progress.task(f"fit of {organ.n_surface} points, {kind}", effort.steps) as under_way:
        if kind == GROUPS:
            stiffness = search(start, group_of(organ, model), misfit, effort.steps, lambda *_: under_way.advance())
        else:
            stiffness = fit(misfit, start, effort.steps, lambda *_: under_way.advance(), bounds=CELL_BOUNDS)
    known = _frequencies(body)
    frequencies = known[:MODES]
    rate = damping_rate(frequencies)
    mass = fit_mass(organ, elastic, stiffness, frequencies)
    if kind in ONE_STEP:
        together = for_one_substep(organ, misfit, start, frequencies, rate)
        stiffness, mass = fit_together(together, stiffness, mass, effort.steps, CELL_BOUNDS)
    made = with_stiffness(organ, model, stiffness)
    names = ("spring_stiffness", "angular_stiffness", "return_stiffness", "cell_mu", "cell_lambda")
    off = np.abs(frequencies_of(elastic, stiffness, mass, MORE_MODES) / known - 1.0)
    motion = {"mass": mass, "damping": rate * mass, "modes_off": np.array([off[:MODES].max(), off[MODES:].max()])}
    return {name: getattr(made, name) for name in names} | motion


def _misfit(elastic: Elastic, body: Body, size: Sized, pushes: Floats) -> Misfit:
    """Return the misfit of an organ's tissue under the reference's forces (c, m, 3) N."""
    forces = np.stack([size.forces(push) for push in pushes])
    some = samples_of(len(pushes))
    found = answers(body, size, pushes)
    better = corrected(found, found[some], answers(_finer(body), size, pushes[some]))
    return Misfit(elastic, *principal(forces, better))


@lru_cache(maxsize=1)
def _finer(body: Body) -> Body:
    pushes = fit_cases(body.organ, SAMPLED, SEED)
    return finer_reference_body(body, pushes[samples_of(len(pushes))])


@lru_cache(maxsize=1)
def _frequencies(body: Body) -> Floats:
    return lowest_frequencies(body, MORE_MODES)
