"""Calibration of an organ: reference answers, fit, masses, and an assessment by held-out loads."""

from __future__ import annotations

from contextlib import AbstractContextManager
from dataclasses import asdict, replace
from typing import NamedTuple

import numpy as np

from tissue_sim.array_types import Floats, Longs
from tissue_sim.calibration.cases import (
    DEPTH,
    HELD_OUT_SEED,
    Cases,
    fit_cases,
    held_out_cases,
    scale_to_depth,
    size_of,
)
from tissue_sim.calibration.checkpoint import Checkpoint
from tissue_sim.calibration.coarseness import check_coarseness
from tissue_sim.calibration.evaluation import (
    Answer,
    Release,
    check_pace,
    check_settled,
    errors,
    released,
    settled_answers,
)
from tissue_sim.calibration.fem import Body
from tissue_sim.calibration.inertia import damping_rate
from tissue_sim.calibration.joint_fit import TICK
from tissue_sim.calibration.progress import Progress
from tissue_sim.calibration.reference import Refined, corrected, corrected_answers, samples_of
from tissue_sim.calibration.reference_process import Poke, Reference
from tissue_sim.calibration.stiffness import Settings, prepared
from tissue_sim.calibration.tissue_fit import Work, fit_tissue
from tissue_sim.errors import UserError
from tissue_sim.json_types import JsonObject
from tissue_sim.model.elasticity.assembly import assemble
from tissue_sim.model.elasticity.frequency import largest_frequency
from tissue_sim.model.stepping.critical_step import model_step, substeps_for
from tissue_sim.organ.organ import Organ
from tissue_sim.version import __version__

BUCKLING = 3.0  # ratio of displacements by the two laws of elasticity, from which a load is near buckling
POKE = 0.005  # m, of the release, for an organ of a kidney's size


class Calibrated(NamedTuple):
    """Calibrated organ and everything that a report shows."""

    organ: Organ
    figures: JsonObject  # also in the organ's provenance, under `calibration`
    cases: Cases  # held out
    wanted: Answer  # of the finite-element body
    linear: Floats  # (c, n_surface, 3) m, of the linear one
    found: Answer  # of the model
    release: Release


def calibrate(organ: Organ, settings: Settings, checkpoint: Checkpoint, progress: Progress) -> Calibrated:
    """Fit an organ's cells or groups of springs, and its masses, to finite elements of its shape and tissue.

    Meanwhile a separate process solves the held-out loads with finite elements; this one solves some of them, too, as
    soon as it has nothing else to do. The result is the same bit for bit with one core and with two.

    Parameters
    ----------
    organ : Organ
        The organ.
    settings : Settings
        Settings of the calibration.
    checkpoint : Checkpoint
        Keeps the intermediate results.
    progress : Progress
        Receives the progress.

    Raises
    ------
    UserError
        Where the organ has no clamp, is too thin for its triangles, comes to rest too slowly or can't be filled, and
        where a library is missing.
    """
    # One core is left to the reference: threads that wait for it would take more time than they save. One thread also
    # gives the same bits on machines of any number of cores.
    with _one_thread():
        return _calibrated(organ, settings, checkpoint, progress)


def _calibrated(organ: Organ, settings: Settings, checkpoint: Checkpoint, progress: Progress) -> Calibrated:
    with progress.stage("preparing", 1) as done:
        check_coarseness(organ)
        start = prepared(organ, settings)
        held_out = held_out_cases(start, settings.smooth, settings.sharp)
        reference = Reference(start, checkpoint, held_out.force)
        try:
            body = Body(start)
            pushes = fit_cases(start, settings.cases, settings.seed)
        except BaseException:
            reference.stop()
            raise
        done(f"{body.n_nodes} nodes, {len(held_out)} held-out loads")
    stiffens = start.stiffening > 0.0
    try:
        with progress.stage("linear reference", 1) as done:
            fitted = checkpoint.remember("linear-fit", lambda: {"fit": body.settle_linear(pushes)})["fit"]
            linear = reference.linear()
            check_pace(start.name, float(linear["frequencies"][0]))
            done(f"{len(pushes)} cases")
        judged = scale_to_depth(held_out, linear["held_out"], start, HELD_OUT_SEED, DEPTH)
        size = (np.linalg.norm(judged.force, axis=(1, 2)) / np.linalg.norm(held_out.force, axis=(1, 2)))[:, None, None]
        judged_linear = linear["held_out"] * size
        rate = damping_rate(linear["frequencies"])

        def poke(wanted: Answer) -> Poke:
            return _poke(judged, wanted, _usable(judged, judged_linear, wanted, stiffens), POKE * size_of(start))

        reference.settle(judged, poke, rate)
        some = samples_of(len(pushes))
        with progress.stage("finer mesh", 1) as done:
            finer = checkpoint.remember(
                "finer-mesh", lambda: corrected_answers(body, judged.force, judged_linear, pushes[some])
            )
            accuracy = Refined(int(finer["nodes"]), int(finer["finer_nodes"]), finer["difference"])
            done(f"{accuracy.finer_nodes} nodes, remaining error at most {accuracy.worst:.2f} %")
        answers = corrected(fitted, fitted[some], finer["samples"])
        tissue = fit_tissue(start, body, (pushes, answers), linear["frequencies"], Work(settings, checkpoint, progress))
        made = tissue.organ
        # This comes before the reference, on which the other process is still working.
        with progress.stage("held-out", len(judged)) as done:
            found = settled_answers(made, judged, done)
            check_settled(start.name, found)
        with progress.stage("held-out reference", len(judged)) as done:
            settled = reference.answer(body, done)
            wanted = settled._replace(displacement=settled.displacement + finer["answers"] - judged_linear)
        with progress.stage("release", 1) as done:
            theirs = reference.motion()
            motion = released(made, *poke(settled), theirs["time"], theirs["displacement"])
            done()
        bent = list(_near_buckling(judged, judged_linear, wanted, stiffens).values())
        unsettled = int(np.count_nonzero(wanted.converged == 0.0))
        kept = _usable(judged, judged_linear, wanted, stiffens)
        judged, judged_linear = judged.chosen(kept), finer["answers"][kept]
        wanted, found = (Answer(*(part[kept] for part in answer)) for answer in (wanted, found))
    finally:
        reference.stop()
    with progress.stage("figures", 1) as done:
        motion_figures = {
            "frequencies_hz": [round(float(v), 4) for v in tissue.frequencies()],
            "reference_hz": [round(float(v), 4) for v in linear["frequencies"]],
            "damping_rate_per_s": round(rate, 4),
            "release_percent": round(100.0 * motion.error, 3),
        }
        step = step_figures(made)
        done()
    figures: JsonObject = {
        "made_of": organ.digest(),
        "version": __version__,
        "method": settings.method,
        "settings": asdict(settings),
        "reference": {
            "nodes": body.n_nodes,
            "unsettled": unsettled,
            "near_buckling": bent,
            "error": str(accuracy),
            "worst_percent": round(accuracy.worst, 3),
        },
        "fit": tissue.figures(),
        "held_out": held_out_figures(judged, wanted, judged_linear, found),
        "motion": motion_figures,
        "step": step,
    }
    provenance = {**made.provenance, "calibration": figures}
    return Calibrated(replace(made, provenance=provenance), figures, judged, wanted, judged_linear, found, motion)


def _one_thread() -> AbstractContextManager[object]:
    """Return a context in which linear algebra has one thread. Raises UserError without threadpoolctl."""
    try:
        from threadpoolctl import threadpool_limits
    except ModuleNotFoundError:
        raise UserError("a calibration needs threadpoolctl: pip install 'tissue_sim[calibration]'") from None
    return threadpool_limits(1)


def _near_buckling(cases: Cases, linear: Floats, wanted: Answer, stiffens: bool = False) -> dict[int, str]:
    """Return the cases that move several times as far under one law of elasticity as the other, and their names.

    Tissue that stiffens may move much less than a linear body without any buckling.
    """
    sizes = [np.linalg.norm(moved, axis=(1, 2)) for moved in (linear, wanted.displacement)]
    deepest = [1e3 * np.linalg.norm(moved, axis=2).max(axis=1) for moved in (linear, wanted.displacement)]
    found = {}
    for case in np.flatnonzero(wanted.converged):
        straight, bent = sizes[0][case], sizes[1][case]
        if bent > BUCKLING * straight or (not stiffens and straight > BUCKLING * bent):
            depth = f"{deepest[0][case]:.1f} mm linear, {deepest[1][case]:.1f} mm nonlinear"
            found[int(case)] = f"{cases.kind[case]} at node {int(cases.centre[case][0])}, {depth}"
    return found


def held_out_figures(cases: Cases, wanted: Answer, linear: Floats, found: Answer) -> JsonObject:
    """Return the errors in percent, separately for smooth and sharp loads, with those of the linear body."""
    error, by_linear = (
        100.0 * errors(found.displacement, wanted.displacement),
        100.0 * errors(linear, wanted.displacement),
    )
    off = np.linalg.norm(found.displacement - wanted.displacement, axis=2)
    deepest = 1e3 * np.linalg.norm(wanted.displacement, axis=2).max(axis=1)
    sharp = np.array([kind == "sharp" for kind in cases.kind], dtype=bool)
    found_figures: JsonObject = {}
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
            "least_volume": {
                "reference": round(float(wanted.least[some].min()), 3),
                "model": round(float(found.least[some].min()), 3),
            },
            "volume_change_percent": {
                "reference": _signed_range(wanted.volume[some]),
                "model": _signed_range(found.volume[some]),
            },
        }
    return found_figures


def step_figures(organ: Organ) -> JsonObject:
    """Return the critical step and the substeps of a millisecond, as Simulation chooses them."""
    model = assemble(organ)
    critical = model_step(model, largest_frequency(model))
    return {"critical_us": round(1e6 * critical, 1), "substeps_a_ms": substeps_for(TICK, critical)}


def _signed_range(volume: Floats) -> list[float]:
    return [round(float(100.0 * value), 4) for value in (volume.min(), volume.mean(), volume.max())]


def _usable(cases: Cases, linear: Floats, wanted: Answer, stiffens: bool = False) -> Longs:
    """Return the cases that settle and are not near buckling."""
    return np.setdiff1d(np.flatnonzero(wanted.converged), list(_near_buckling(cases, linear, wanted, stiffens)))


def _poke(cases: Cases, wanted: Answer, kept: Longs, deep: float) -> Poke:
    """Return forces that dent the finite-element body by about a depth, m, preferably a bump, and the node there.

    Raises UserError when no case is kept.
    """
    if not len(kept):
        raise UserError("the finite elements converge under none of the held-out loads; check the organ's fixed nodes")
    centre = np.array([nodes[0] for nodes in cases.centre])
    depth = np.linalg.norm(wanted.displacement[np.arange(len(cases)), centre], axis=1)
    bump = np.array([kind == "bump" for kind in cases.kind], dtype=bool)
    off = np.abs(depth - deep) + np.where(bump, 0.0, 1.0)
    case = int(kept[np.argmin(off[kept])])
    return cases.force[case] * (deep / depth[case]), int(centre[case])
