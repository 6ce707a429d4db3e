"""Fit of the stiffness of springs or cells to displacements of the finite-element body, linear about rest.

A small residual of forces may be a large error of displacements, so the misfit is that of the surface at equilibrium;
its gradient by every stiffness comes from one adjoint solve for each case.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize

from tissue_sim.array_types import Floats
from tissue_sim.calibration.elastic import Elastic
from tissue_sim.calibration.factor import Factor

BOUNDS = (-6.0, 3.0)  # of the logarithm of stiffness over that at the start
UNTOLD = 1e-4  # fraction of the squared displacements of the linear cases: a tenth of the model's error
MEMORY = 20  # steps that L-BFGS remembers
PROBES = 8  # draws that the misfit's curvature is estimated from
EVEN = 0.1  # of the median curvature, added to each, so that stiffness of little influence isn't moved arbitrarily
# The curvature's power by which each logarithm is scaled. At 1/2, which makes all curvatures equal, a hundred
# evaluations end higher on every organ that was tried: far from the fit, the largest curvature isn't the largest gain.
EVENED = 0.35


class Penalties(NamedTuple):
    """Weights of a fit's penalties.

    shrink: on the mean square of the logarithms of stiffness over that at the start, so that what the cases don't
    determine stays as it was; soften: on the trace of the stiffness matrix over that at the start, which bounds the
    largest frequency.
    """

    shrink: float = 3e-4
    soften: float = 1e-3


PENALTIES = Penalties()


class Evaluation(NamedTuple):
    """Misfit at some stiffness: the mean square of the cases' relative errors."""

    loss: float
    slope: Floats  # (p,) of the loss by each stiffness
    error: Floats  # (c,) relative L2, |u - u_wanted| / |u_wanted| over the surface


class Misfit:
    """Misfit of the model's linear response about rest, of all cases at once.

    Loads that overlap are combined into fewer, r, that represent all of the wanted displacements except UNTOLD of their
    square: thousands of cases take no longer than those.

    Parameters
    ----------
    elastic : Elastic
        The model about rest.
    force : Floats, shape (c, n_surface, 3), N
        Loads of the cases.
    wanted : Floats, shape (c, n_surface, 3), m
        Displacements of the finite-element body.
    """

    def __init__(self, elastic: Elastic, force: Floats, wanted: Floats) -> None:
        self.elastic = elastic
        free, inside = elastic.free, elastic.free < 3 * elastic.n_surface
        self._inside = inside
        answers = wanted.reshape(len(wanted), -1)[:, free[inside]]
        size = np.linalg.norm(answers, axis=1, keepdims=True)
        answers = answers / size
        self.combinations = _combinations(answers)
        self._wanted = answers.T @ self.combinations
        self._load = np.zeros((len(free), self.combinations.shape[1]))
        self._load[inside] = (force.reshape(len(force), -1)[:, free[inside]] / size).T @ self.combinations

    def evaluate(self, stiffness: Floats, factor: Factor | None = None) -> Evaluation:
        """Return loss, gradient and errors: two solves, and a factorisation unless the factor is given.

        Parameters
        ----------
        stiffness : Floats, shape (p,)
            Stiffness of every spring or cell.
        factor : Factor | None, optional
            Factorised tangent of that stiffness.
        """
        factor = factor or self.elastic.factor(self.elastic.tangent(stiffness))
        answer = factor.solve(self._load)
        off = answer[self._inside] - self._wanted
        square = np.einsum("cr,rq,cq->c", self.combinations, off.T @ off, self.combinations, optimize=True)
        pull = np.zeros_like(answer)
        pull[self._inside] = 2.0 / len(square) * off
        adjoint = factor.solve(pull)
        slope = -self.elastic.sensitivity(answer, adjoint)
        return Evaluation(float(square.mean()), slope, np.sqrt(np.maximum(square, 0.0)))

    def curvature(self, stiffness: Floats) -> Floats:
        """Return the approximate curvature of the loss by each stiffness' logarithm, (p,), of the Gauss-Newton matrix.

        An entry is the sum of the squares of the slopes of all displacements; the square of the slope of their sum,
        each with a random sign, has the same mean (Bekas, Kokiopoulou & Saad 2007).
        """
        factor = self.elastic.factor(self.elastic.tangent(stiffness))
        answer, random = factor.solve(self._load), np.random.default_rng(0)
        found, probe = np.zeros(len(stiffness)), np.zeros_like(answer)
        for _ in range(PROBES):
            probe[self._inside] = random.choice([-1.0, 1.0], self._wanted.shape)
            found += (stiffness * self.elastic.sensitivity(answer, factor.solve(probe))) ** 2
        found *= 2.0 / (PROBES * len(self.combinations))
        return found


def _combinations(answers: Floats) -> Floats:
    """Return orthonormal combinations (c, r) of rows (c, a), the strongest ones."""
    strength, combined = np.linalg.eigh(answers @ answers.T)
    weak = np.searchsorted(np.cumsum(np.maximum(strength, 0.0)), UNTOLD * len(answers))
    return np.ascontiguousarray(combined[:, weak:])


def fit(
    misfit: Misfit,
    start: Floats,
    iterations: int,
    watch: Callable[[int, Floats], None] | None = None,
    penalties: Penalties = PENALTIES,
    bounds: tuple[float, float] = BOUNDS,
) -> Floats:
    """Return the stiffness of least misfit, by L-BFGS on its logarithms.

    Each logarithm is scaled so that the loss curves more evenly: where an organ is held by a small clamp, some cells
    count a hundred thousand times as much as most.

    Parameters
    ----------
    misfit : Misfit
        The misfit.
    start : Floats, shape (p,)
        Stiffness at the start.
    iterations : int
        Largest number of evaluations.
    watch : Callable[[int, Floats], None] | None, optional
        Called with the number of every evaluation and the errors (c,) found.
    penalties : Penalties, optional
        Weights of the penalties.
    bounds : tuple[float, float], optional
        Of the logarithm of stiffness relative to the start.

    Returns
    -------
    Floats, shape (p,)
        Stiffness.
    """
    shrink, soften = penalties
    trace = misfit.elastic.trace()
    total = float(trace @ start)
    curvature = misfit.curvature(start) + 2.0 * shrink / len(start)
    unit = (curvature / np.median(curvature) + EVEN) ** -EVENED
    count = 0

    def objective(counted: Floats) -> tuple[float, Floats]:
        nonlocal count
        logarithm = unit * counted
        stiffness = start * np.exp(logarithm)
        found = misfit.evaluate(stiffness)
        loss = found.loss + shrink * float(np.mean(logarithm**2)) + soften * float(trace @ stiffness) / total
        slope = (found.slope + soften / total * trace) * stiffness + 2.0 * shrink / len(logarithm) * logarithm
        count += 1
        if watch is not None:
            watch(count, found.error)
        return loss, slope * unit

    limits = np.outer(1.0 / unit, bounds)
    best = unit * descended(objective, np.zeros(len(start)), limits, iterations)
    stiffness: Floats = start * np.exp(np.clip(best, *bounds))
    return stiffness


def descended(
    objective: Callable[[Floats], tuple[float, Floats]],
    start: Floats,
    bounds: Floats | Sequence[tuple[float, float]],
    evaluations: int,
) -> Floats:
    """Return the point that L-BFGS reaches.

    Parameters
    ----------
    objective : Callable[[Floats], tuple[float, Floats]]
        Returns loss and gradient (p,) at a point (p,).
    start : Floats, shape (p,)
        Start.
    bounds : Floats | Sequence[tuple[float, float]]
        Least and largest value of each coordinate.
    evaluations : int
        Largest number of evaluations.

    Returns
    -------
    Floats, shape (p,)
        The point.
    """
    options = {"maxfun": evaluations, "maxiter": evaluations, "maxcor": MEMORY, "gtol": 0.0, "ftol": 1e-10}
    best: Floats = minimize(objective, start, jac=True, method="L-BFGS-B", bounds=bounds, options=options).x
    return best
