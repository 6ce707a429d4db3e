"""From an organ to a calibrated one: reference answers, fit, masses, and what held-out loads say of it."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, closing
from dataclasses import asdict, dataclass, replace
from typing import Any, NamedTuple, Protocol

import numpy as np

from tissue_sim.array_types import Floats
from tissue_sim.calibration import fit as fitting
from tissue_sim.calibration.background import Reference, Task
from tissue_sim.calibration.cases import DEEP, DEPTH, HELD_OUT_SEED, Cases, fit_cases, held_out_cases, scale_to_depth
from tissue_sim.calibration.cells import Cells
from tissue_sim.calibration.checkpoint import Arrays, Checkpoint
from tissue_sim.calibration.dynamics import lowest_frequencies
from tissue_sim.calibration.fe_mesh import Grading
from tissue_sim.calibration.fem import Body
from tissue_sim.calibration.fit import Evaluation, LinearMisfit, Misfit, SharedMisfit
from tissue_sim.calibration.groups import GROUPS, group_of, search
from tissue_sim.calibration.inertia import MODES, damping_rate, fit_mass, frequencies_of
from tissue_sim.calibration.judge import RELEASE_STEPS, Answer, Release, errors, released, settled_answers
from tissue_sim.calibration.reference import reference_error
from tissue_sim.calibration.static import Springs
from tissue_sim.errors import UserError
from tissue_sim.model.assembly import Model, assemble
from tissue_sim.model.critical_step import largest_frequency, model_step, substeps_for
from tissue_sim.organ.cell_mesh import with_cells
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.topology import assemble_like

METHODS = ("springs", "groups", "cells")
RETURN_START = 0.01  # of the organ's return springs, where the fit begins: the clamp holds the organ
# Of the springs, as tissue has it. Linear cases don't tell it; without it the model dents too deep under large loads
# and snaps (held out, fitted to linear cases alone: 7.3 % mean, and 4.0 % with it).
HARDENING = 1.6
INTERIOR_SHARE = {"springs": 0.15, "groups": 0.0, "cells": 0.6}  # interior atoms for each surface node
CELL_LAYER = 0.7  # of them, in a layer under the surface
GROUP_STEPS = 4  # evaluations of the search over groups for one of the fit, which takes more time
COARSE = Grading(clamp=0)  # of the mesh on which the fit's nonlinear cases are settled
NONLINEAR_SHARE = 0.5  # of the misfit, of the large loads; the rest is that of the linear ones
CELL_START = (1.0, 0.5)  # of the tissue's mu and lambda: where the fit of cells begins
CELL_BOUNDS = (-3.5, 2.5)  # of the logarithm of a cell's moduli over those: without, some cells are all but void
POKE = 0.005  # m, of the release
TICK = 1e-3  # s


@dataclass(frozen=True)
class Settings:
    """What a calibration is made with.

    cases: linear ones, nonlinear: settled ones of the fit; smooth and sharp: held-out ones; interior: atoms in the
    result, None for those that the organ has or else 15 for 100 surface nodes (none for groups, as in the paper; for
    cells always 60, most of them in a layer under the surface);
    hardening: of the springs in the result, None for HARDENING (the organ's own for groups);
    steps and nonlinear_steps: evaluations of the fit before and after nonlinear cases come in.
    """

    seed: int = 0
    method: str = "springs"
    cases: int = 1600
    nonlinear: int = 96
    steps: int = 120
    nonlinear_steps: int = 24
    interior: int | None = None
    hardening: float | None = None
    smooth: int = 30
    sharp: int = 10


class Progress(Protocol):
    """Where a calibration tells how far it is."""

    def stage(self, name: str, total: int) -> AbstractContextManager[Callable[..., None]]:
        """A stage of `total` steps; what comes back is called after each, with a remark if there is one."""
        ...


class Calibrated(NamedTuple):
    """A calibrated organ and all that a report shows."""

    organ: Organ
    figures: dict[str, Any]  # also in the organ's provenance, under `calibration`
    cases: Cases  # held out
    wanted: Answer  # of the finite-element body
    linear: Floats  # (c, n_surface, 3) m, of the linear one
    found: Answer  # of the model
    release: Release


def calibrate(organ: Organ, settings: Settings, checkpoint: Checkpoint, progress: Progress) -> Calibrated:
    """Fit the organ's springs or cells, and its masses, to a finite-element body of its shape and tissue; judge them.

    The finite-element body settles the nonlinear cases in a process of its own meanwhile.
    Raises UserError when the organ has no clamp or can't be filled, or a library is missing.
    """
    start = prepared(organ, settings)
    body = Body(start)
    held_out = held_out_cases(start, settings.smooth, settings.sharp)
    linear_cases = fit_cases(start, settings.cases, settings.seed)
    nonlinear = fit_cases(start, settings.nonlinear if settings.method == "springs" else 0, settings.seed, stream=2)

    def respond() -> Arrays:
        return {
            "fit": body.settle_linear(linear_cases.force),
            "nonlinear": body.settle_linear(nonlinear.force),
            "held_out": body.settle_linear(held_out.force),
            "frequencies": lowest_frequencies(body, MODES),
        }

    with progress.stage("linear reference", 1) as done:
        linear = checkpoint.remember("linear-reference", respond)
        done(f"{body.n_nodes} nodes, {settings.cases} cases")
    nonlinear, nonlinear_linear = _scaled(nonlinear, linear["nonlinear"], start, settings.seed, DEEP)
    judged, judged_linear = _scaled(held_out, linear["held_out"], start, HELD_OUT_SEED, DEPTH)
    tasks = {"nonlinear": Task(nonlinear, COARSE, nonlinear_linear), "held-out": Task(judged)}
    model = assemble(start)
    springs: Springs | Cells
    if settings.method == "cells":
        springs = Cells(model)
        prior = np.concatenate([start.cell_mu, start.cell_lambda])
    else:
        springs = Springs(model)
        prior = first_stiffness(model, springs)
    misfit = LinearMisfit(springs, linear_cases.force, linear["fit"])
    reference = Reference(start, checkpoint, tasks)
    try:
        if isinstance(springs, Cells):
            stiffness, fitted = _by_cells(springs, prior, misfit, settings, checkpoint, progress)
        elif settings.method == "groups":
            stiffness, fitted = _by_groups(start, springs, prior, misfit, settings, progress)
        else:
            stiffness, fitted = _by_springs(
                springs, prior, misfit, nonlinear, reference, settings, checkpoint, progress
            )
        with progress.stage("masses", 1) as done:
            mass = checkpoint.remember(
                "mass", lambda: {"mass": fit_mass(start, springs, stiffness, linear["frequencies"])}
            )["mass"]
            done()
        rate = damping_rate(linear["frequencies"])
        made = replace(
            with_moduli(start, stiffness) if isinstance(springs, Cells) else with_stiffness(start, springs, stiffness),
            mass=mass,
            damping=rate * mass,
        )
        with progress.stage("held-out reference", len(judged)) as done:
            wanted = reference.answer("held-out", done)
        kept = np.flatnonzero(wanted.converged)
        judged, judged_linear = judged.chosen(kept), judged_linear[kept]
        wanted = Answer(*(part[kept] for part in wanted))
        with progress.stage("held-out", len(judged)) as done:
            found = settled_answers(made, judged, done)
    finally:
        reference.stop()
    with progress.stage("error of the reference", 1) as done:
        accuracy = reference_error(start)
        done(f"{accuracy.worst:.2f} % at worst")
    with progress.stage("release", RELEASE_STEPS) as done:
        poke, node = _poke(judged, wanted)
        history = checkpoint.remember("release", lambda: released(made, body, poke, node, rate, done)._asdict())
        motion = Release(**history)
    figures: dict[str, Any] = {
        "method": settings.method,
        "settings": asdict(settings),
        "reference": {
            "nodes": body.n_nodes,
            "left_out": int(len(held_out) - len(kept)),
            "error": str(accuracy),
            "worst_percent": round(accuracy.worst, 3),
        },
        "fit": fitted,
        "held_out": held_out_figures(judged, wanted, judged_linear, found),
        "motion": {
            "frequencies_hz": [round(float(v), 4) for v in frequencies_of(springs, stiffness, mass)],
            "reference_hz": [round(float(v), 4) for v in linear["frequencies"]],
            "damping_rate_per_s": round(rate, 4),
            "release_percent": round(100.0 * motion.error, 3),
        },
        "step": step_figures(made),
    }
    provenance = {**made.provenance, "calibration": figures}
    return Calibrated(replace(made, provenance=provenance), figures, judged, wanted, judged_linear, found, motion)


def _scaled(
    cases: Cases, compliance: Floats, organ: Organ, seed: int, depth: tuple[float, float]
) -> tuple[Cases, Floats]:
    """Cases scaled to a depth, and the linear body's answers (c, n_surface, 3) m to them."""
    scaled = scale_to_depth(cases, compliance, organ, seed, depth)
    size = np.linalg.norm(scaled.force, axis=(1, 2)) / np.linalg.norm(cases.force, axis=(1, 2))
    return scaled, compliance * size[:, None, None]


def held_out_figures(cases: Cases, wanted: Answer, linear: Floats, found: Answer) -> dict[str, Any]:
    """Errors in percent, smooth and sharp loads apart, with those of the linear body beside them."""
    error, by_linear = (
        100.0 * errors(found.displacement, wanted.displacement),
        100.0 * errors(linear, wanted.displacement),
    )
    off = np.linalg.norm(found.displacement - wanted.displacement, axis=2)
    deepest = 1e3 * np.linalg.norm(wanted.displacement, axis=2).max(axis=1)
    sharp = np.array([kind == "sharp" for kind in cases.kind], dtype=bool)
    found_figures: dict[str, Any] = {}
    for name, some in (("smooth", ~sharp), ("sharp", sharp)):
        if not some.any():
            continue
        found_figures[name] = {
            "cases": int(some.sum()),
            "settled": int(found.converged[some].sum()),
            "mean_percent": round(float(error[some].mean()), 3),
            "worst_percent": round(float(error[some].max()), 3),
            "rms_mm": round(float(1e3 * np.sqrt(np.mean(off[some] ** 2))), 4),
            "deepest_mm": round(float(deepest[some].max()), 3),
            "linear_elasticity_mean_percent": round(float(by_linear[some].mean()), 3),
            "volume_change_percent": {
                "reference": _signed_range(wanted.volume[some]),
                "model": _signed_range(found.volume[some]),
            },
        }
    return found_figures


def step_figures(organ: Organ) -> dict[str, Any]:
    """Critical step and substeps of a millisecond, as Simulation chooses them."""
    model = assemble(organ)
    critical = model_step(model, largest_frequency(model))
    return {"critical_us": round(1e6 * critical, 1), "substeps_a_ms": max(2, substeps_for(TICK, critical))}


def _signed_range(volume: Floats) -> list[float]:
    return [round(float(100.0 * value), 4) for value in (volume.min(), volume.mean(), volume.max())]


# the organ ----------------------------------------------------------------------------------------


def prepared(organ: Organ, settings: Settings) -> Organ:
    """The organ with the interior atoms and hardening wanted, its springs as they are built when the atoms change."""
    if settings.method not in METHODS:
        raise UserError(f"unknown method '{settings.method}'; choose one of {', '.join(METHODS)}")
    by_cells = settings.method == "cells"
    interior, hardening = settings.interior, settings.hardening
    if interior is None:
        interior = 0 if by_cells else organ.n_interior
        interior = interior or round(INTERIOR_SHARE[settings.method] * organ.n_surface)
    if hardening is None:
        hardening = HARDENING if settings.method == "springs" else organ.hardening
    organ = replace(organ, hardening=hardening)
    if interior != organ.n_interior or by_cells:
        provenance = {key: value for key, value in organ.provenance.items() if key != "calibration"}
        organ = assemble_like(
            organ,
            interior_atoms=interior,
            interior_layer=CELL_LAYER if by_cells else 0.0,
            provenance={**provenance, "interior_atoms": interior},
        )
    return with_cells(organ, CELL_START) if by_cells else without_cells(organ)


def without_cells(organ: Organ) -> Organ:
    """The organ with springs alone."""
    return replace(organ, cell_nodes=organ.cell_nodes[:0], cell_mu=organ.cell_mu[:0], cell_lambda=organ.cell_lambda[:0])


def with_moduli(organ: Organ, moduli: Floats) -> Organ:
    """The organ with moduli (2c,) Pa of its cells: mu, then lambda."""
    mu, lam = moduli.reshape(2, -1)
    return replace(organ, cell_mu=mu, cell_lambda=lam)


def first_stiffness(model: Model, springs: Springs) -> Floats:
    """Stiffnesses (p,) N/m in the order of Springs where a fit begins: the model's, its return springs weakened."""
    axial, angular, pulls = springs.split(springs.stiffness_of(model))
    return np.concatenate([axial, angular, RETURN_START * pulls])


def with_stiffness(organ: Organ, springs: Springs, stiffness: Floats) -> Organ:
    """The organ with stiffnesses (p,) N/m in the order of Springs."""
    axial, angular, pulls = springs.split(stiffness)
    spring, hinge, pull = (
        np.array(values) for values in (organ.spring_stiffness, organ.angular_stiffness, organ.return_stiffness)
    )
    spring[spring > 0.0] = axial
    hinge[hinge > 0.0] = angular
    pull[springs.pulled] = pulls
    # Nothing reads those of held nodes, but they would stand in the file as what they were.
    pull[organ.fixed] = 0.0
    return replace(organ, spring_stiffness=spring, angular_stiffness=hinge, return_stiffness=pull)


def _poke(cases: Cases, wanted: Answer) -> tuple[Floats, int]:
    """Forces that dent the finite-element body by about 5 mm, and the node in their middle: of a held-out bump."""
    centre = np.array([nodes[0] for nodes in cases.centre])
    depth = np.linalg.norm(wanted.displacement[np.arange(len(cases)), centre], axis=1)
    bump = np.array([kind == "bump" for kind in cases.kind], dtype=bool)
    order = np.argsort(np.abs(depth - POKE) + np.where(bump, 0.0, 1.0), kind="stable")
    case = int(order[0])
    return cases.force[case] * (POKE / depth[case]), int(centre[case])


# the fit ------------------------------------------------------------------------------------------


def _by_springs(
    springs: Springs,
    prior: Floats,
    misfit: LinearMisfit,
    nonlinear: Cases,
    reference: Reference,
    settings: Settings,
    checkpoint: Checkpoint,
    progress: Progress,
) -> tuple[Floats, dict[str, Any]]:
    """Every spring: first on the linear cases alone, then with the nonlinear ones."""
    trace = springs.trace()
    logged = _Logged(misfit, "linear", checkpoint)
    with progress.stage("fit", settings.steps) as done:
        stiffness = fitting.fit(prior, trace, [(1.0, logged)], settings.steps, watch=_remark(done))
    last = logged.last
    if len(nonlinear) and settings.nonlinear_steps:
        with progress.stage("nonlinear reference", len(nonlinear)) as done:
            answer = reference.answer("nonlinear", done)
        kept = np.flatnonzero(answer.converged)
        settled = SharedMisfit(springs, nonlinear.force[kept], answer.displacement[kept])
        both = _Logged(misfit, "both-linear", checkpoint), _Logged(settled, "both-nonlinear", checkpoint)
        with progress.stage("nonlinear fit", settings.nonlinear_steps) as done, closing(settled):
            stiffness = fitting.fit(
                stiffness,
                trace,
                [(1.0 - NONLINEAR_SHARE, both[0]), (NONLINEAR_SHARE, both[1])],
                settings.nonlinear_steps,
                prior=prior,
                watch=_remark(done),
            )
        last = {**both[0].last, "nonlinear_" + "mean_percent": both[1].last["mean_percent"]}
        last["nonlinear_worst_percent"] = both[1].last["worst_percent"]
    return stiffness, last


def _by_cells(
    cells: Cells,
    prior: Floats,
    misfit: LinearMisfit,
    settings: Settings,
    checkpoint: Checkpoint,
    progress: Progress,
) -> tuple[Floats, dict[str, Any]]:
    """Both moduli of every cell, on the linear cases: their law tells the rest."""
    logged = _Logged(misfit, "linear", checkpoint)
    with progress.stage("fit", settings.steps) as done:
        moduli = fitting.fit(
            prior, cells.trace(), [(1.0, logged)], settings.steps, watch=_remark(done), bounds=CELL_BOUNDS
        )
    return moduli, logged.last


def _by_groups(
    organ: Organ, springs: Springs, prior: Floats, misfit: LinearMisfit, settings: Settings, progress: Progress
) -> tuple[Floats, dict[str, Any]]:
    """One factor for each group."""
    group = group_of(organ, springs)
    steps = GROUP_STEPS * (settings.steps + settings.nonlinear_steps)
    with progress.stage("fit", steps) as done:
        stiffness = search(prior, group, misfit, steps, lambda _, error: done(f"{100.0 * error.mean():.2f} %"))
    error = misfit.evaluate(stiffness).error
    factors = {GROUPS[k]: float(np.median((stiffness / prior)[group == k])) for k in np.unique(group)}
    return stiffness, {**_figures(error), "factors": factors}


class _Logged:
    """A misfit whose evaluations are kept, so that a fit that was stopped finds its way back bit for bit."""

    def __init__(self, misfit: Misfit, name: str, checkpoint: Checkpoint) -> None:
        self._misfit, self._name, self._checkpoint = misfit, name, checkpoint
        self._count = 0
        self._replayed: Arrays | None = None  # the last evaluation, where the misfit itself has yet to come
        self._evaluated = False
        self.last: dict[str, Any] = {}

    def evaluate(self, stiffness: Floats) -> Evaluation:
        """As the misfit does, or as it did."""
        self._evaluated = False
        kept = self._checkpoint.remember(f"{self._name}-{self._count:04d}", lambda: self._evaluate(stiffness))
        self._replayed = None if self._evaluated else kept
        self._count += 1
        self.last = _figures(kept["error"])
        return Evaluation(float(kept["loss"]), kept["slope"], kept["error"])

    def _evaluate(self, stiffness: Floats) -> Arrays:
        if self._replayed is not None and isinstance(self._misfit, SharedMisfit):
            self._misfit.restore(self._replayed["position"], self._replayed["stiffness"])
        found = self._misfit.evaluate(stiffness)
        self._evaluated = True
        kept = {"loss": np.array(found.loss), "slope": found.slope, "error": found.error}
        if isinstance(self._misfit, SharedMisfit):
            kept |= {"position": self._misfit.position, "stiffness": self._misfit.stiffness}
        return kept


def _figures(error: Floats) -> dict[str, Any]:
    return {
        "mean_percent": round(float(100.0 * error.mean()), 3),
        "worst_percent": round(float(100.0 * error.max()), 3),
    }


def _remark(done: Callable[..., None]) -> Callable[[int, list[Evaluation]], None]:
    """Tell the mean error of the last kind of cases after every evaluation."""
    return lambda _, found: done(f"{100.0 * found[-1].error.mean():.2f} %")
