"""Joint fit of stiffness and masses, so that the model is stable in a longer step and still moves as the tissue.

Masses alone can't do it: those that slow the fastest modes down also slow the lowest ones. Stiffness that decreases
where a node is light, and mass that gathers where tissue is stiff, share the work. The misfit of the settled loads
assesses the stiffness; the lowest frequencies, and those of the fastest modes that the step doesn't allow, assess both.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
from scipy.sparse import csc_array
from scipy.sparse.linalg import eigsh

from tissue_sim.array_types import Floats
from tissue_sim.calibration.fit import Misfit, descended
from tissue_sim.calibration.inertia import modes_of, tissue_mass
from tissue_sim.model.elasticity.diagonal import diagonal
from tissue_sim.model.stepping.critical_step import SAFETY, stable_frequency
from tissue_sim.organ.organ import Organ

FASTEST = 40  # fastest modes that are kept below what the step allows
CLOSE = 0.985  # of the squared frequency that the step allows: a mode counts before it exceeds it
# Weights of the lowest and of the fastest modes, beside a misfit of some 1e-3, and the fraction of the evaluations.
STAGES = ((0.3, 0.03, 1.0 / 3.0), (1.0, 1.0, 2.0 / 3.0))
SHRINK = 1e-4  # weight of the mean square of the logarithms of stiffness
TOTAL = 1e-1  # weight of the whole mass, which the lowest frequencies determine only in part
SPREAD = 1e-4  # weight of the mean square of the masses' logarithms, over those of the tissue around
MASS_BOUNDS = (-3.0, 4.0)  # of these logarithms
ROUGH = 1e-5  # of a squared frequency, to which the fastest are found
TICK = 1e-3  # s, of the tick that one substep should do for
ROOM = 1.03  # of that step, which loads make too long


class Together:
    """Loss of stiffness and masses as a function of their logarithms, (p + moving nodes,).

    Parameters
    ----------
    misfit : Misfit
        Misfit of the settled loads.
    first : Floats, shape (p,)
        Stiffness from which the logarithms count; those of masses count from the tissue around each node.
    frequencies : Floats, Hz
        Lowest frequencies.
    largest : float, rad/s
        Frequency below which the fastest modes should stay.
    organ : Organ
        The organ.
    """

    def __init__(self, organ: Organ, misfit: Misfit, first: Floats, frequencies: Floats, largest: float) -> None:
        self.misfit, self.first = misfit, first
        self.around, self.moving = tissue_mass(organ), misfit.elastic.moving
        self._lowest = (2.0 * np.pi * np.asarray(frequencies)) ** 2
        self._most = CLOSE * largest**2
        self._start = np.random.default_rng(0).standard_normal(len(misfit.elastic.free))

    def split(self, logarithm: Floats) -> tuple[Floats, Floats]:
        """Return stiffness (p,) and masses (n,), kg.

        Parameters
        ----------
        logarithm : Floats, shape (p + moving nodes,)
            Their logarithms.
        """
        mass = self.around.copy()
        mass[self.moving] *= np.exp(logarithm[len(self.first) :])
        return self.first * np.exp(logarithm[: len(self.first)]), mass

    def join(self, stiffness: Floats, mass: Floats) -> Floats:
        """Return the logarithms of stiffness and masses.

        Parameters
        ----------
        stiffness : Floats, shape (p,)
            Stiffness of every spring or cell.
        mass : Floats, shape (n,), kg
            Masses of the nodes.
        """
        return np.concatenate([np.log(stiffness / self.first), np.log(mass / self.around)[self.moving]])

    def evaluate(self, logarithm: Floats, low: float, high: float) -> tuple[float, Floats, Floats]:
        """Return the loss, its gradient by every logarithm, and the errors (c,) of the cases.

        Parameters
        ----------
        logarithm : Floats, shape (p + moving nodes,)
            The logarithms.
        low : float
            Weight of the lowest modes.
        high : float
            Weight of the fastest modes.
        """
        elastic, count = self.misfit.elastic, len(self.first)
        stiffness, mass = self.split(logarithm)
        tangent, axis_mass = elastic.tangent(stiffness), np.repeat(mass, 3)[elastic.free]
        factor = elastic.factor(tangent)
        found = self.misfit.evaluate(stiffness, factor)
        loss, by_stiffness, by_mass = found.loss, found.slope, np.zeros(len(logarithm) - count)
        square, shape = modes_of(tangent, factor, axis_mass, len(self._lowest), self._start)
        top, fast = _fastest(tangent, axis_mass, self._start)
        off, beyond = square / self._lowest - 1.0, np.maximum(top / self._most - 1.0, 0.0)
        # A squared frequency s of a shape p with p'Mp = 1 changes by p'(dK - s dM)p.
        for weight, amount, unit, level, moved in (
            (low, off, self._lowest, square, shape),
            (high, beyond, self._most, top, fast),
        ):
            loss += weight * float(amount @ amount)
            pull = 2.0 * weight * amount / unit
            by_stiffness = by_stiffness + np.bincount(elastic.owner, (elastic.rows @ moved) ** 2 @ pull, count)
            by_mass -= np.sum(moved.reshape(-1, 3, len(level)) ** 2, axis=1) @ (pull * level)
        total = float(self.around[self.moving].sum())
        excess = float(mass[self.moving].sum()) / total - 1.0
        softer, heavier = logarithm[:count], logarithm[count:]
        loss += TOTAL * excess**2 + SHRINK * float(np.mean(softer**2)) + SPREAD * float(np.mean(heavier**2))
        slope = np.concatenate(
            [
                by_stiffness * stiffness + 2.0 * SHRINK / count * softer,
                (by_mass + 2.0 * TOTAL * excess / total) * mass[self.moving] + 2.0 * SPREAD / len(heavier) * heavier,
            ]
        )
        return loss, slope, found.error


def for_one_substep(organ: Organ, misfit: Misfit, first: Floats, frequencies: Floats, damping_rate: float) -> Together:
    """Return the loss for an organ that should take one substep per tick of 1 ms.

    Parameters
    ----------
    organ : Organ
        The organ.
    misfit : Misfit
        Misfit of the settled loads.
    first : Floats, shape (p,)
        Stiffness from which the logarithms count.
    frequencies : Floats, Hz
        Lowest frequencies.
    damping_rate : float, 1/s
        Damping over mass.
    """
    return Together(organ, misfit, first, frequencies, stable_frequency(ROOM * TICK / SAFETY, damping_rate))


def fit_together(
    together: Together,
    stiffness: Floats,
    mass: Floats,
    evaluations: int,
    bounds: tuple[float, float],
    watch: Callable[[int, Floats], None] | None = None,
) -> tuple[Floats, Floats]:
    """Return the stiffness and masses of least loss, by L-BFGS from those given.

    Parameters
    ----------
    together : Together
        The loss.
    stiffness : Floats, shape (p,)
        Stiffness at the start.
    mass : Floats, shape (n,), kg
        Masses at the start.
    evaluations : int
        Largest number of evaluations.
    bounds : tuple[float, float]
        Of the logarithms of stiffness.
    watch : Callable[[int, Floats], None] | None, optional
        Called with the number of every evaluation and the errors (c,) found.

    Returns
    -------
    tuple[Floats, Floats]
        Stiffness, shape (p,), and masses, shape (n,), kg.
    """
    made = 0

    def objective(logarithm: Floats, low: float, high: float) -> tuple[float, Floats]:
        nonlocal made
        loss, slope, error = together.evaluate(logarithm, low, high)
        made += 1
        if watch is not None:
            watch(made, error)
        return loss, slope

    at = together.join(stiffness, mass)
    limits = [bounds] * len(stiffness) + [MASS_BOUNDS] * (len(at) - len(stiffness))
    at = np.clip(at, *np.transpose(limits))
    for low, high, fraction in STAGES:
        at = descended(partial(objective, low=low, high=high), at, limits, max(1, round(fraction * evaluations)))
    return together.split(at)


def _fastest(tangent: csc_array, mass: Floats, start: Floats) -> tuple[Floats, Floats]:
    """Return the largest squared frequencies (FASTEST,) 1/s^2, and shapes (a, FASTEST) 1/sqrt(kg) of masses (a,) kg."""
    root = 1.0 / np.sqrt(mass)
    scaled = (diagonal(root) @ tangent @ diagonal(root)).tocsr()
    square, shape = eigsh(scaled, k=min(FASTEST, len(mass) - 1), which="LA", v0=start, tol=ROUGH)
    return square, shape * root[:, None]
