"""Calibration of the paper: an iterative search over one factor for each group of springs.

Section 3.3: "an iterative approach is used to obtain the appropriate parameters of the elastic system, such as d, k, m
of the inner structure and the outer mesh respectively". The paper gives no details; here it is the simplex of Nelder &
Mead (1965), which needs no gradient. It is the baseline for the fit of cells.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.optimize import minimize

from tissue_sim.array_types import Floats, Longs
from tissue_sim.calibration.fit import Evaluation, Misfit
from tissue_sim.model.data.model import Model
from tissue_sim.organ.organ import Organ, SpringKind

GROUPS = ("edges", "inner", "skeleton", "angular", "return")
FIRST_STEP = 0.25  # factor on one group's stiffness, in each corner of the first simplex but one
LIMITS = (1e-6, 1e3)  # of a group's stiffness over that at the start


def group_of(organ: Organ, model: Model) -> Longs:
    """Return the number in GROUPS of every stiffness: outer mesh, spokes and virtual springs, skeleton, and the rest.

    Parameters
    ----------
    organ : Organ
        The organ.
    model : Model
        The organ's model.

    Returns
    -------
    Longs, shape (p,)
        Group of each stiffness.
    """
    kind = organ.spring_kind[organ.spring_stiffness > 0.0]
    axial = np.select([kind == SpringKind.EDGE, kind == SpringKind.SKELETON], [0, 2], 1)
    return np.concatenate([axial, np.full(len(model.angular_nodes), 3), np.full(len(model.return_nodes), 4)])


def search(
    start: Floats, group: Longs, misfit: Misfit, iterations: int, watch: Callable[[int, Floats], None] | None = None
) -> Floats:
    """Return the stiffness of least misfit that one factor for each group reaches, never worse than the start.

    Parameters
    ----------
    start : Floats, shape (p,), N/m
        Stiffness at the start.
    group : Longs, shape (p,)
        Group of each stiffness.
    misfit : Misfit
        The misfit.
    iterations : int
        Largest number of evaluations.
    watch : Callable[[int, Floats], None] | None, optional
        Called with the number of every evaluation and the best errors (c,) so far.

    Returns
    -------
    Floats, shape (p,), N/m
        Stiffness.
    """
    present = np.unique(group)
    best: Evaluation | None = None
    stiffness, count = start, 0

    def objective(logarithm: Floats) -> float:
        nonlocal best, stiffness, count
        factors = np.ones(len(GROUPS))
        factors[present] = np.exp(logarithm)
        tried = start * factors[group]
        found = misfit.evaluate(tried)
        count += 1
        if best is None or found.loss < best.loss:
            best, stiffness = found, tried
        if watch is not None:
            watch(count, best.error)
        return found.loss

    simplex = np.concatenate([np.zeros((1, len(present))), np.log(FIRST_STEP) * np.eye(len(present))])
    minimize(
        objective,
        np.zeros(len(present)),
        method="Nelder-Mead",
        bounds=[(np.log(LIMITS[0]), np.log(LIMITS[1]))] * len(present),
        options={"maxfev": iterations, "initial_simplex": simplex, "xatol": 1e-3, "fatol": 1e-9, "adaptive": True},
    )
    return stiffness
