"""Settled shapes of the spring model: Newton's method on its energy, and what each spring adds to its forces.

The energy is that of model.energy, the forces are those of model.forces; here they come with tangents, and with the
stiffnesses as arguments, so that a fit can change them without an organ being assembled anew.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from scipy.sparse import coo_array, csc_array, csr_array

from tissue_sim.array_types import Floats, Longs
from tissue_sim.calibration import spring_kernels as kernels
from tissue_sim.calibration.elastic import Elastic
from tissue_sim.calibration.factor import Factor
from tissue_sim.calibration.pattern import Pattern
from tissue_sim.model.assembly import Model
from tissue_sim.model.modes import free_axes

TOLERANCE = 1e-8  # residual force over load that counts as settled
MOST_ITERATIONS = 60
_LONGEST_STEP = 0.01  # m that a node moves in one iteration at the most
_LEAST_SHARE = 1e-4  # of a Newton step, below which the search along it gives up
_ARMIJO = 1e-4
_SLOW = 0.25  # of the last residual, above which a tangent is made anew


class Settled(NamedTuple):
    """A settled shape of the model."""

    position: Floats  # (n, 3) m
    converged: bool
    stable: bool  # the energy has a minimum there, no saddle
    iterations: int


class Springs:
    """The springs of a model as functions of position and stiffness.

    Stiffnesses (p,) N/m stand in one array: axial, then angular, then return springs, as the model has them.
    Only the model's topology, rest shape and rest lengths are used, never its stiffnesses.
    """

    def __init__(self, model: Model) -> None:
        self.rest = model.rest
        self.n_surface = model.n_surface
        self.free = free_axes(model)
        self.ends = np.stack([model.spring_first, model.spring_second], axis=1).astype(np.int64)
        self.length = model.spring_rest_length
        self.hardening = model.hardening
        self.hinges = model.angular_nodes.astype(np.int64)
        self.weight = model.angular_weight
        self.bent = model.angular_rest
        self.least = model.angular_least_area
        self.pulled = model.return_nodes.astype(np.int64)
        self.counts = (len(self.ends), len(self.hinges), len(self.pulled))
        self._pattern = Pattern(self.rest, self.free, (self.ends, self.hinges, self.pulled[:, None]))

    def stiffness_of(self, model: Model) -> Floats:
        """The stiffnesses (p,) N/m of a model of this topology."""
        pulls = model.return_stiffness[self.pulled]
        return np.concatenate([model.spring_stiffness, model.angular_stiffness, pulls])

    def split(self, values: Floats) -> tuple[Floats, Floats, Floats]:
        """Values (p, ...) of axial, angular and return springs."""
        first, second = self.counts[0], self.counts[0] + self.counts[1]
        return values[:first], values[first:second], values[second:]

    def trace(self) -> Floats:
        """What a unit of each stiffness (p,) adds to the trace of the tangent at rest."""
        bending = np.sum(self._bending(self.rest).slope ** 2, axis=(1, 2))
        return np.concatenate([np.full(self.counts[0], 2.0), bending, np.full(self.counts[2], 3.0)])

    # energy and forces -------------------------------------------------------------------------
    def energy_and_gradient(self, position: Floats, stiffness: Floats) -> tuple[float, Floats]:
        """Elastic energy, J, and its gradient (n, 3) N: the force that must be applied to hold the shape."""
        axial, angular, pulls = self.split(stiffness)
        gradient = np.zeros_like(position)
        total = kernels.axial_energy(position, self.ends, self.length, self.hardening, axial, gradient)
        total += kernels.hinge_energy(position, *self._hinge_arguments(), angular, gradient, self._work())
        away = position[self.pulled] - self.rest[self.pulled]
        gradient[self.pulled] += pulls[:, None] * away
        return float(total + 0.5 * pulls @ np.sum(away**2, axis=1)), gradient

    def _hinge_arguments(self) -> tuple[Any, ...]:
        return self.hinges, self.weight, self.bent, self.least

    def _work(self) -> Floats:
        return np.empty((kernels.WORK, 3, 3))

    def _slopes(self, position: Floats) -> tuple[Floats, Floats, Floats]:
        """Energy gradients over stiffness: axial (s, 3) at the second end, angular (h, 4, 3), return (r, 3)."""
        axial = np.empty((len(self.ends), 3))
        kernels.axial_slopes(position, self.ends, self.length, self.hardening, axial)
        bending = self._bending(position)
        angular = (bending.curvature - self.bent)[:, None, None] * bending.slope
        return axial, angular, position[self.pulled] - self.rest[self.pulled]

    def sensitivity(self, position: Floats, direction: Floats) -> Floats:
        """What each stiffness adds to the energy gradient along a direction (n, 3): (p,)."""
        stretch, bend, away = self._slopes(position)
        change = direction[self.ends[:, 1]] - direction[self.ends[:, 0]]
        return np.concatenate(
            [
                np.einsum("sx,sx->s", stretch, change),
                np.einsum("hcx,hcx->h", bend, direction[self.hinges]),
                np.einsum("rx,rx->r", away, direction[self.pulled]),
            ]
        )

    # tangents ----------------------------------------------------------------------------------
    def tangent(self, position: Floats, stiffness: Floats, convex: bool = False) -> csc_array:
        """Second derivative of the energy over the free axes, (a, a) N/m.

        convex: without what a pushed spring's turning takes from it, so that the matrix is positive definite.
        """
        axial, angular, pulls = self.split(stiffness)
        data = np.zeros(self._pattern.entries)
        targets = self._pattern.targets
        kernels.axial_tangent(position, self.ends, self.length, self.hardening, axial, convex, targets[0], data)
        kernels.hinge_tangent(position, *self._hinge_arguments(), angular, convex, targets[1], data, self._work())
        pulled = np.einsum("rcc->rc", targets[2][:, 0, 0]).ravel()
        free = pulled >= 0
        data[pulled[free]] += np.repeat(pulls, 3)[free]
        return self._pattern.matrix(data)

    def factor(self, tangent: csc_array) -> Factor:
        """A factored tangent."""
        return self._pattern.factor(tangent)

    def rest_tangent(self, stiffness: Floats) -> csc_array:
        """The tangent at rest, where springs carry no force."""
        return self.tangent(self.rest, stiffness, convex=True)

    def strain_rows(self) -> tuple[csc_array, Longs]:
        """Strains of axial and angular springs about rest as a matrix over the free axes, and the return springs' rows.

        Rows (s + h + 3r, a): lengths, curvatures, displacements by axis; the second part names each row's stiffness.
        """
        along = self.rest[self.ends[:, 1]] - self.rest[self.ends[:, 0]]
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        s, h, r = self.counts
        slope = self._bending(self.rest).slope
        axes = np.arange(3)
        rows = [np.repeat(np.arange(s), 6), s + np.repeat(np.arange(h), 12), s + h + np.arange(3 * r)]
        columns = [
            (3 * self.ends[:, :, None] + axes).ravel(),
            (3 * self.hinges[:, :, None] + axes).ravel(),
            (3 * self.pulled[:, None] + axes).ravel(),
        ]
        values = [np.stack([-along, along], axis=1).ravel(), slope.ravel(), np.ones(3 * r)]
        shape = (s + h + 3 * r, 3 * len(self.rest))
        entries = (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns)))
        owner = np.concatenate([np.arange(s + h), s + h + np.repeat(np.arange(r), 3)])
        return coo_array(entries, shape=shape).tocsc()[:, self.free], owner

    def rest_sensitivity(self, answer: Floats, adjoint: Floats) -> Floats:
        """What each stiffness (p,) adds to the work that rest_tangent answer does along adjoint; both (a, r)."""
        rows, owner = self._strains
        return np.bincount(owner, np.einsum("rc,rc->r", rows @ adjoint, rows @ answer), sum(self.counts))

    @cached_property
    def _strains(self) -> tuple[csr_array, Longs]:
        rows, owner = self.strain_rows()
        return rows.tocsr(), owner

    # hinges ------------------------------------------------------------------------------------
    def _bending(self, position: Floats) -> _Bending:
        """Curvature of every angular spring and its slope; forces.edge_forces has the law."""
        at = position[self.hinges]
        edge, across = at[:, 1] - at[:, 0], at[:, 2] - at[:, 3]
        normal = np.cross(edge, across)
        square = np.einsum("hx,hx->h", normal, normal)
        sound = square > self.least
        inverse = 1.0 / np.sqrt(np.where(sound, square, self.least))
        normal *= inverse[:, None]
        sum_of = np.einsum("hc,hcx->hx", self.weight, at)
        curvature = np.einsum("hx,hx->h", sum_of, normal)
        turning = (sum_of - np.where(sound, curvature, 0.0)[:, None] * normal) * inverse[:, None]
        slope = self.weight[:, :, None] * normal[:, None, :]
        by_edge, by_across = np.cross(across, turning), np.cross(turning, edge)
        slope[:, 0] -= by_edge
        slope[:, 1] += by_edge
        slope[:, 2] += by_across
        slope[:, 3] -= by_across
        return _Bending(curvature, slope)


class _Bending(NamedTuple):
    curvature: Floats  # (h,) m
    slope: Floats  # (h, 4, 3)


def settle(
    springs: Elastic,
    stiffness: Floats,
    force: Floats,
    start: Floats | None = None,
    factor: Factor | None = None,
    tolerance: float = TOLERANCE,
    iterations: int = MOST_ITERATIONS,
) -> tuple[Settled, Factor | None]:
    """Shape in which springs of stiffness (p,) N/m balance forces (n_surface, 3) N; and the factored tangent there.

    start (n, 3) m: where Newton's method begins, the rest shape by default; factor: of a tangent nearby. A tangent
    stays in use while the residual falls by a factor of four with every step; a step goes as far as the energy falls
    (Armijo); a tangent that is not positive definite goes without what takes that from it. No factor comes back where
    the shape doesn't converge or is a saddle.
    """
    load = np.zeros_like(springs.rest)
    load[: springs.n_surface] = force
    size = max(float(np.linalg.norm(load)), 1e-300)
    position: Floats = (springs.rest if start is None else start).copy()
    energy, slope = springs.energy_and_gradient(position, stiffness)
    potential = energy - float(np.vdot(load, position))
    left, worn = np.inf, factor is None
    for iteration in range(iterations):
        residual = (slope - load).ravel()[springs.free]
        before, left = left, float(np.linalg.norm(residual))
        if left <= tolerance * size:
            factor = springs.factor(springs.tangent(position, stiffness))
            stable = factor.is_positive
            return Settled(position, True, stable, iteration), factor if stable else None
        worn = worn or left > _SLOW * before
        if factor is None or worn:
            factor = springs.factor(springs.tangent(position, stiffness))
            if not factor.is_positive:
                factor = springs.factor(springs.tangent(position, stiffness, convex=True))
        move = np.zeros(position.size)
        move[springs.free] = -factor.solve(residual)
        fall = float(residual @ move[springs.free])
        way: Floats = move.reshape(position.shape)
        share = min(1.0, _LONGEST_STEP / float(np.linalg.norm(way, axis=1).max()))
        while share > _LEAST_SHARE:
            moved = position + share * way
            energy, ahead = springs.energy_and_gradient(moved, stiffness)
            reached = energy - float(np.vdot(load, moved))
            # Near the minimum rounding hides how far the potential falls.
            if reached <= potential + _ARMIJO * share * fall + 1e-13 * abs(potential):
                position, potential, slope, worn = moved, reached, ahead, False
                break
            share *= 0.5
        else:
            if worn:
                break
            left, worn = np.inf, True  # once more from here with a tangent of this place
    return Settled(position, False, False, iteration + 1), None
