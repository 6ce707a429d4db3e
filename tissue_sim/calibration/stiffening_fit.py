"""Fit of the cells' stiffening to finite elements of the tissue's.

Linear cells represent the mean strain of a few millimetres, which is smaller than the largest one that finite elements
find there. The same exponential law would stiffen them too little: their b is larger than the tissue's by a factor.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.optimize import minimize_scalar

from tissue_sim.calibration.cases import held_out_cases, scale_to_depth, split_centres
from tissue_sim.calibration.evaluation import errors, settled_answers
from tissue_sim.calibration.fem import Body
from tissue_sim.organ.organ import Organ

SMOOTH, SHARP = 12, 3  # loads; by eight of them the factor varied by a fifth
BOUNDS = (0.5, 4.0)  # of the factor
CLOSE = 0.03  # of the factor's logarithm
EVALUATIONS = 8  # at most
STEPS = SMOOTH + SHARP + EVALUATIONS  # of the whole fit, for a progress


def fit_stiffening(organ: Organ, body: Body, seed: int, done: Callable[..., None]) -> float:
    """Return the cells' b over the tissue's with the least mean squared error under large loads.

    The loads are of the kind of the held-out ones, at nodes of the linear fit.

    Parameters
    ----------
    organ : Organ
        The calibrated organ, of tissue that stiffens.
    body : Body
        Its finite elements.
    seed : int
        Seed of the loads.
    done : Callable[..., None]
        Called after each load and each evaluation.

    Returns
    -------
    float
        The factor; 1 where no load converges.
    """
    unit = held_out_cases(organ, SMOOTH, SHARP, seed, split_centres(organ)[0])
    cases = scale_to_depth(unit, body.settle_linear(unit.force), organ, seed)
    settled = []
    for answer in body.settle_many(list(cases.force)):
        settled.append(answer)
        done()
    kept = np.flatnonzero([answer.converged for answer in settled])
    if not len(kept):
        return 1.0
    cases, wanted = cases.chosen(kept), np.stack([settled[case].displacement for case in kept])

    def misfit(logarithm: float) -> float:
        found = settled_answers(replace(organ, cell_stiffening=float(np.exp(logarithm))), cases)
        error = errors(found.displacement, wanted)
        done(f"factor {np.exp(logarithm):.2f}, {100.0 * error.mean():.2f} %")
        return float(np.mean(error**2))

    options = {"xatol": CLOSE, "maxiter": EVALUATIONS}
    best = minimize_scalar(misfit, bounds=tuple(np.log(BOUNDS)), method="bounded", options=options)
    return float(np.exp(best.x))
