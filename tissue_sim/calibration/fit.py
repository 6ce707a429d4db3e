"""Fit of every spring's stiffness to settled displacements of the finite-element body.

Force balance alone is a poor guide (a small residual of forces may be a large error of displacements), so the misfit
is that of the settled surface; its slope by every stiffness comes from one adjoint solve for each case.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple, Protocol

import numpy as np
from scipy.optimize import minimize

from tissue_sim.array_types import Floats
from tissue_sim.calibration.elastic import Elastic
from tissue_sim.calibration.factor import Factor
from tissue_sim.calibration.remote import Remote
from tissue_sim.calibration.static import settle

BOUNDS = (-6.0, 3.0)  # of the logarithm of stiffness over that at the start
SHRINK = 1e-4  # weight of the mean square of those logarithms: what the cases don't tell stays as it was
SOFTEN = 1e-3  # weight of the trace of the stiffness matrix over that at the start, which bounds the largest frequency
UNTOLD = 1e-4  # of the squared displacements of the linear cases: a tenth of what the model is off by
PROCESSES = 2  # among which the nonlinear cases are shared out
MEMORY = 20  # steps that L-BFGS remembers
LOOSE = 1e-6  # residual force over load, in a fit
OUTLIER = 0.25  # error from which on a nonlinear case counts less and less (Cauchy), so that none outweighs the rest
_LOST = 1.0  # loss of a case that finds no rest


class Evaluation(NamedTuple):
    """Misfit at some stiffness: the mean square of the cases' relative errors."""

    loss: float
    slope: Floats  # (p,) of the loss by each stiffness
    error: Floats  # (c,) relative L2, |u - u_wanted| / |u_wanted| over the surface


class Misfit(Protocol):
    """Anything that tells the misfit at stiffness (p,) N/m."""

    def evaluate(self, stiffness: Floats) -> Evaluation:
        """Loss, slope and errors."""
        ...


class LinearMisfit:
    """Misfit of the model's linear response about rest, all cases at once.

    Loads that overlap are combined into fewer, r, that tell all of the wanted displacements but UNTOLD of their square:
    thousands of cases take no longer than those.

    force (c, n_surface, 3) N, wanted (c, n_surface, 3) m.
    """

    def __init__(self, springs: Elastic, force: Floats, wanted: Floats) -> None:
        self._springs = springs
        free, inside = springs.free, springs.free < 3 * springs.n_surface
        self._inside = inside
        answers = wanted.reshape(len(wanted), -1)[:, free[inside]]
        size = np.linalg.norm(answers, axis=1, keepdims=True)
        answers = answers / size
        self.combinations = _combinations(answers)
        self._wanted = answers.T @ self.combinations
        self._load = np.zeros((len(free), self.combinations.shape[1]))
        self._load[inside] = (force.reshape(len(force), -1)[:, free[inside]] / size).T @ self.combinations

    def evaluate(self, stiffness: Floats) -> Evaluation:
        """Loss, slope and errors; one factorisation, two solves."""
        factor = self._springs.factor(self._springs.rest_tangent(stiffness))
        answer = factor.solve(self._load)
        off = answer[self._inside] - self._wanted
        square = np.einsum("cr,rq,cq->c", self.combinations, off.T @ off, self.combinations, optimize=True)
        pull = np.zeros_like(answer)
        pull[self._inside] = 2.0 / len(square) * off
        adjoint = factor.solve(pull)
        slope = -self._springs.rest_sensitivity(answer, adjoint)
        return Evaluation(float(square.mean()), slope, np.sqrt(np.maximum(square, 0.0)))


def _combinations(answers: Floats) -> Floats:
    """Orthonormal combinations (c, r) of rows (c, a), the strongest ones."""
    strength, combined = np.linalg.eigh(answers @ answers.T)
    weak = np.searchsorted(np.cumsum(np.maximum(strength, 0.0)), UNTOLD * len(answers))
    return np.ascontiguousarray(combined[:, weak:])


class NonlinearMisfit:
    """Misfit of the model's settled shapes, case by case; each starts where it last came to rest.

    The loss of a case is b^2 log(1 + e^2 / b^2) of its error e, which is e^2 as long as that is well below b = 0.25.

    force (c, n_surface, 3) N, wanted (c, n_surface, 3) m; tolerance: residual force over load that counts as settled.
    """

    def __init__(self, springs: Elastic, force: Floats, wanted: Floats, tolerance: float = LOOSE) -> None:
        self._springs, self._force, self._wanted = springs, force, wanted
        self._tolerance = tolerance
        self._weight = 1.0 / np.sum(wanted**2, axis=(1, 2))
        # Where each case last came to rest, (c, n, 3) m, and under which stiffness (c, p); not finite: nowhere yet.
        self.position = np.full((len(force), *springs.rest.shape), np.nan)
        self.stiffness = np.full((len(force), sum(springs.counts)), np.nan)
        self._factor: list[Factor | None] = [None] * len(force)

    def state(self) -> tuple[Floats, Floats]:
        """What `restore` takes."""
        return self.position, self.stiffness

    def restore(self, position: Floats, stiffness: Floats) -> None:
        """Go on from shapes and stiffnesses, as `position` and `stiffness` held them."""
        self.position, self.stiffness = position.copy(), stiffness.copy()
        for case in range(len(position)):
            if np.isfinite(stiffness[case, 0]):
                self._factor[case] = self._springs.factor(self._springs.tangent(position[case], stiffness[case]))

    def evaluate(self, stiffness: Floats) -> Evaluation:
        """Loss, slope and errors; a case that finds no rest adds 1 to the sum of losses."""
        cases = [self._case(stiffness, case) for case in range(len(self._force))]
        square = np.array([found[0] for found in cases])
        found_rest = np.array([found[3] is not None for found in cases], dtype=bool)
        loss = np.where(found_rest, OUTLIER**2 * np.log1p(square / OUTLIER**2), _LOST)
        slope = (1.0 / (1.0 + square / OUTLIER**2)) @ np.array([found[1] for found in cases]) / len(cases)
        for case, (_, _, position, factor) in enumerate(cases):
            if factor is not None:
                self.position[case], self._factor[case] = position, factor
                self.stiffness[case] = stiffness
        return Evaluation(float(loss.mean()), slope, np.sqrt(square))

    def _case(self, stiffness: Floats, case: int) -> tuple[float, Floats, Floats, Factor | None]:
        """Squared error, its slope, the shape of one case and its factored tangent."""
        springs = self._springs
        start = self.position[case] if self._factor[case] is not None else None
        settled, factor = settle(springs, stiffness, self._force[case], start, self._factor[case], self._tolerance)
        if factor is None and start is not None:
            settled, factor = settle(springs, stiffness, self._force[case], None, None, self._tolerance)
        if factor is None:
            return 1.0, np.zeros_like(stiffness), settled.position, None
        surface = slice(springs.n_surface)
        off = settled.position[surface] - springs.rest[surface] - self._wanted[case]
        pull = np.zeros_like(settled.position)
        pull[surface] = 2.0 * self._weight[case] * off
        adjoint = np.zeros(pull.size)
        adjoint[springs.free] = factor.solve(pull.ravel()[springs.free])
        slope = -springs.sensitivity(settled.position, adjoint.reshape(pull.shape))
        return float(np.sum(off**2) * self._weight[case]), slope, settled.position, factor


class SharedMisfit:
    """A NonlinearMisfit whose cases are shared out among processes."""

    def __init__(self, springs: Elastic, force: Floats, wanted: Floats, processes: int = PROCESSES) -> None:
        self._parts = [slice(k, None, processes) for k in range(min(processes, len(force)))]
        self._remotes = [Remote(NonlinearMisfit, springs, force[part], wanted[part]) for part in self._parts]
        self._threads = ThreadPoolExecutor(len(self._parts))
        self.position = np.full((len(force), *springs.rest.shape), np.nan)
        self.stiffness = np.full((len(force), sum(springs.counts)), np.nan)

    def restore(self, position: Floats, stiffness: Floats) -> None:
        """As NonlinearMisfit's."""
        self._each("restore", [(position[part], stiffness[part]) for part in self._parts])

    def evaluate(self, stiffness: Floats) -> Evaluation:
        """As NonlinearMisfit's; bit for bit the same for the same number of processes."""
        found: list[Evaluation] = self._each("evaluate", [(stiffness,)] * len(self._parts))
        states = self._each("state", [()] * len(self._parts))
        error = np.empty(len(self.position))
        loss, slope = 0.0, np.zeros_like(stiffness)
        for part, evaluation, state in zip(self._parts, found, states, strict=True):
            error[part], (self.position[part], self.stiffness[part]) = evaluation.error, state
            share = len(evaluation.error) / len(error)
            loss, slope = loss + share * evaluation.loss, slope + share * evaluation.slope
        return Evaluation(loss, slope, error)

    def close(self) -> None:
        """End the processes."""
        for remote in self._remotes:
            remote.close()
        self._threads.shutdown()

    def _each(self, method: str, arguments: list[tuple[Any, ...]]) -> list[Any]:
        asked = [
            self._threads.submit(remote.call, method, *given)
            for remote, given in zip(self._remotes, arguments, strict=True)
        ]
        return [answer.result() for answer in asked]


def fit(
    start: Floats,
    trace: Floats,
    misfits: Sequence[tuple[float, Misfit]],
    iterations: int,
    prior: Floats | None = None,
    watch: Callable[[int, list[Evaluation]], None] | None = None,
    shrink: float = SHRINK,
    soften: float = SOFTEN,
    bounds: tuple[float, float] = BOUNDS,
) -> Floats:
    """Stiffnesses (p,) N/m of the least weighted misfit, from those at the start, by L-BFGS on their logarithms.

    trace (p,): what each unit of stiffness adds to the trace of the stiffness matrix; misfits: each with its weight;
    iterations: evaluations at the most; prior: stiffness towards which what isn't told is drawn, the start by default;
    watch: told the number of every evaluation and what it found; bounds: of the logarithm of stiffness over the prior.
    """
    prior = start if prior is None else prior
    total = float(trace @ prior)
    count = 0

    def objective(logarithm: Floats) -> tuple[float, Floats]:
        nonlocal count
        stiffness = prior * np.exp(logarithm)
        found = [misfit.evaluate(stiffness) for _, misfit in misfits]
        loss = shrink * float(np.mean(logarithm**2)) + soften * float(trace @ stiffness) / total
        slope = 2.0 * shrink / len(logarithm) * logarithm + soften / total * trace * stiffness
        for (weight, _), evaluation in zip(misfits, found, strict=True):
            loss += weight * evaluation.loss
            slope = slope + weight * evaluation.slope * stiffness
        count += 1
        if watch is not None:
            watch(count, found)
        return loss, slope

    best = minimize(
        objective,
        np.clip(np.log(start / prior), *bounds),
        jac=True,
        method="L-BFGS-B",
        bounds=[bounds] * len(start),
        options={"maxfun": iterations, "maxiter": iterations, "maxcor": MEMORY, "gtol": 0.0, "ftol": 1e-10},
    )
    stiffness: Floats = prior * np.exp(best.x)
    return stiffness
