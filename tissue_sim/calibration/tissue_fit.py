"""Fit of an organ's stiffness, masses and stiffening to the answers of its finite-element body."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from tissue_sim.array_types import Floats, Longs
from tissue_sim.calibration.cases import principal
from tissue_sim.calibration.checkpoint import Arrays, Checkpoint
from tissue_sim.calibration.elastic import Elastic
from tissue_sim.calibration.fem import Body
from tissue_sim.calibration.fit import Misfit, fit
from tissue_sim.calibration.groups import GROUPS, group_of, search
from tissue_sim.calibration.inertia import damping_rate, fit_mass, frequencies_of
from tissue_sim.calibration.joint_fit import Together, fit_together, for_one_substep
from tissue_sim.calibration.progress import Progress
from tissue_sim.calibration.stiffening_fit import STEPS, fit_stiffening
from tissue_sim.calibration.stiffness import ONE_STEP, Settings, first_stiffness, with_stiffness
from tissue_sim.model.elasticity.assembly import assemble
from tissue_sim.organ.organ import Organ

CELL_BOUNDS = (-3.5, 2.5)  # of a modulus' logarithm relative to the start; without, some cells are almost void
GROUP_STEPS = 4  # evaluations of the search over groups for each one of the fit, which takes more time


class Work(NamedTuple):
    """Context of a calibration: its settings, its intermediate results, and its progress reporter."""

    settings: Settings
    checkpoint: Checkpoint
    progress: Progress


class Fitted(NamedTuple):
    """Fitted organ, its stiffness (p,) and masses (n,) kg, and the errors (c,) of the fitted loads."""

    organ: Organ
    elastic: Elastic
    stiffness: Floats
    mass: Floats
    error: Floats
    factors: dict[str, float]  # of the stiffness of each group of springs; none where cells were fitted

    def frequencies(self) -> Floats:
        """Return its lowest frequencies, Hz."""
        return frequencies_of(self.elastic, self.stiffness, self.mass)

    def figures(self) -> dict[str, object]:
        """Return the figures of the fit, as JSON can hold them."""
        found: dict[str, object] = {
            "mean_percent": round(float(100.0 * self.error.mean()), 3),
            "worst_percent": round(float(100.0 * self.error.max()), 3),
        }
        if self.factors:
            found["factors"] = self.factors
        if self.organ.stiffening > 0.0:
            found["stiffening_of_cells"] = round(self.organ.cell_stiffening, 3)
        return found


def fit_tissue(start: Organ, body: Body, loads: tuple[Floats, Floats], frequencies: Floats, work: Work) -> Fitted:
    """Fit an organ's cells or groups of springs, its masses, and the stiffening of its cells.

    Parameters
    ----------
    start : Organ
        The organ, ready to be fitted.
    body : Body
        Its finite-element body.
    loads : tuple[Floats, Floats], shapes (c, n_surface, 3) N and m
        Loads, and the linear answers of the body.
    frequencies : Floats, Hz
        Lowest frequencies of the body.
    work : Work
        What it is done with.
    """
    settings, checkpoint, progress = work
    with progress.stage("model", 1) as done:
        model = assemble(start)
        elastic = Elastic(model)
        misfit = Misfit(elastic, *principal(*loads))
        first = first_stiffness(start, model)
        group = group_of(start, model) if settings.method == "groups" else None
        done()
    with progress.stage("fit", _most_evaluations(settings)) as done:
        stiffness = checkpoint.remember("fit", lambda: {"stiffness": _fitted(first, group, misfit, settings, done)})[
            "stiffness"
        ]
        error = misfit.evaluate(stiffness).error
        done(f"{100.0 * error.mean():.2f} %")
    with progress.stage("masses", 1) as done:
        mass = checkpoint.remember("mass", lambda: {"mass": fit_mass(start, elastic, stiffness, frequencies)})["mass"]
        done()
    rate = damping_rate(frequencies)
    if settings.method == "cells" and settings.aim in ONE_STEP:
        together = for_one_substep(start, misfit, first, frequencies, rate)
        with progress.stage("both for a step of 1 ms", 3 * settings.evaluations // 2) as done:
            both = checkpoint.remember("both", lambda: _both(together, stiffness, mass, settings, done))
            stiffness, mass = both["stiffness"], both["mass"]
            error = misfit.evaluate(stiffness).error
            done(f"{100.0 * error.mean():.2f} %")
    made = replace(with_stiffness(start, model, stiffness), mass=mass, damping=rate * mass)
    if start.stiffening > 0.0:
        made = _stiffened(made, body, work)
    ratio, groups = stiffness / first, () if group is None else np.unique(group)
    factors = {GROUPS[one]: float(np.median(ratio[group == one])) for one in groups}
    return Fitted(made, elastic, stiffness, mass, error, factors)


def _stiffened(organ: Organ, body: Body, work: Work) -> Organ:
    """Return the organ with b of its cells fitted to the finite elements' answers to large loads."""
    with work.progress.stage("stiffening", STEPS) as done:
        factor = work.checkpoint.remember(
            "stiffening", lambda: {"factor": np.array([fit_stiffening(organ, body, work.settings.seed, done)])}
        )["factor"]
        made = replace(organ, cell_stiffening=float(factor[0]))
        done(f"the cells' b is {made.cell_stiffening:.2f} times the tissue's")
        return made


def _most_evaluations(settings: Settings) -> int:
    """Return the largest number of evaluations of the misfit.

    The search over groups has no gradient, and takes less time for each; a fit with masses starts from a rough one.
    """
    if settings.method == "groups":
        return settings.evaluations * GROUP_STEPS
    return max(1, settings.evaluations // 2) if settings.aim in ONE_STEP else settings.evaluations


def _watcher(done: Callable[..., None]) -> Callable[[int, Floats], None]:
    """Return what a fit calls after every evaluation."""
    return lambda _, error: done(f"{100.0 * error.mean():.2f} %")


def _fitted(
    first: Floats, group: Longs | None, misfit: Misfit, settings: Settings, done: Callable[..., None]
) -> Floats:
    """Return the stiffness (p,) of least misfit, of every cell, or with one factor for each group (p,) of springs."""
    watch = _watcher(done)
    if group is not None:
        return search(first, group, misfit, _most_evaluations(settings), watch)
    return fit(misfit, first, _most_evaluations(settings), watch, bounds=CELL_BOUNDS)


def _both(together: Together, stiffness: Floats, mass: Floats, settings: Settings, done: Callable[..., None]) -> Arrays:
    """Return stiffness (p,) and masses (n,) kg fitted together."""
    stiffness, mass = fit_together(
        together, stiffness, mass, 3 * settings.evaluations // 2, CELL_BOUNDS, _watcher(done)
    )
    return {"stiffness": stiffness, "mass": mass}
