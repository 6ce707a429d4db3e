"""Settled shapes of the spring model: Newton's method on its energy, and what each spring adds to its forces.

The energy is that of model.energy, the forces are those of model.forces; here they come with tangents, and with the
stiffnesses as arguments, so that a fit can change them without an organ being assembled anew.
"""

from __future__ import annotations

from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csc_array

from tissue_sim.calibration.factor import Elimination, Factor
from tissue_sim.model.assembly import Model
from tissue_sim.model.forces import SHORTEST
from tissue_sim.model.modes import free_axes
from tissue_sim.organ.organ import Floats

Longs = NDArray[np.int64]

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
        self.hinges = model.angular_nodes.astype(np.int64)
        self.weight = model.angular_weight
        self.bent = model.angular_rest
        self.least = model.angular_least_area
        self.pulled = model.return_nodes.astype(np.int64)
        self.counts = (len(self.ends), len(self.hinges), len(self.pulled))
        self._index()

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
    def energy(self, position: Floats, stiffness: Floats) -> float:
        """Elastic energy, J."""
        axial, angular, pulls = self.split(stiffness)
        along = position[self.ends[:, 1]] - position[self.ends[:, 0]]
        length, shortest = np.linalg.norm(along, axis=1), SHORTEST * self.length
        stretch = (np.maximum(length, shortest) - self.length) ** 2
        stretch -= (1.0 / SHORTEST - 1.0) * np.minimum(length**2 - shortest**2, 0.0)
        bending = self._bending(position)
        away = np.sum((position[self.pulled] - self.rest[self.pulled]) ** 2, axis=1)
        return 0.5 * float(axial @ stretch + angular @ (bending.curvature - self.bent) ** 2 + pulls @ away)

    def gradient(self, position: Floats, stiffness: Floats) -> Floats:
        """Gradient (n, 3) N of the energy: the force that must be applied to hold the shape."""
        return self._add_up(position, stiffness, self._slopes(position))

    def _slopes(self, position: Floats) -> tuple[Floats, Floats, Floats]:
        """Energy gradients over stiffness: axial (s, 3) at the second end, angular (h, 4, 3), return (r, 3)."""
        along = position[self.ends[:, 1]] - position[self.ends[:, 0]]
        length = np.maximum(np.linalg.norm(along, axis=1), SHORTEST * self.length)
        axial = (1.0 - self.length / length)[:, None] * along
        bending = self._bending(position)
        angular = (bending.curvature - self.bent)[:, None, None] * bending.slope
        return axial, angular, position[self.pulled] - self.rest[self.pulled]

    def _add_up(self, position: Floats, stiffness: Floats, slopes: tuple[Floats, Floats, Floats]) -> Floats:
        axial, angular, pulls = self.split(stiffness)
        stretch, bend, away = slopes
        total = np.zeros_like(position)
        push = axial[:, None] * stretch
        turn = angular[:, None, None] * bend
        for axis in range(3):
            total[:, axis] += np.bincount(self.ends[:, 1], push[:, axis], len(total))
            total[:, axis] -= np.bincount(self.ends[:, 0], push[:, axis], len(total))
            total[:, axis] += np.bincount(self.hinges.ravel(), turn[:, :, axis].ravel(), len(total))
        total[self.pulled] += pulls[:, None] * away
        return total

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
        along = position[self.ends[:, 1]] - position[self.ends[:, 0]]
        length = np.linalg.norm(along, axis=1)
        pull = 1.0 - self.length / np.maximum(length, SHORTEST * self.length)
        steep = np.where(length > SHORTEST * self.length, self.length / np.maximum(length, 1e-12) ** 3, 0.0)
        if convex:
            steep = np.where(pull < 0.0, 1.0 / np.maximum(length, 1e-12) ** 2, steep)
            pull = np.maximum(pull, 0.0)
        block = steep[:, None, None] * along[:, :, None] * along[:, None, :]
        block += pull[:, None, None] * np.eye(3)
        block *= axial[:, None, None]
        bending = self._bending(position)
        flat = bending.slope.reshape(-1, 12)
        bent = flat[:, :, None] * flat[:, None, :]
        if not convex:
            bent += (bending.curvature - self.bent)[:, None, None] * self._turning(position, bending)
        bent *= angular[:, None, None]
        diagonal = np.repeat(pulls, 3)
        values = np.concatenate([block.ravel(), bent.ravel(), diagonal])
        return self._assembled(values)

    def factor(self, tangent: csc_array) -> Factor:
        """A factored tangent."""
        return Factor(self._elimination, tangent)

    @cached_property
    def _elimination(self) -> Elimination:
        return Elimination(self.rest, self.free, self._rows, self._starts)

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

    def _index(self) -> None:
        """Where the entries of every spring's block go in the tangent, once for all positions."""
        axes = np.arange(3)
        ends = (3 * self.ends[:, :, None] + axes).reshape(-1, 6)
        # A spring's block B stands four times: B at (i, i) and (j, j), -B at (i, j) and (j, i).
        rows, columns, sources, signs = [], [], [], []
        number = 9 * np.arange(len(ends))[:, None, None] + 3 * axes[:, None] + axes
        for a in range(2):
            for b in range(2):
                rows.append(np.broadcast_to(ends[:, 3 * a : 3 * a + 3, None], number.shape).ravel())
                columns.append(np.broadcast_to(ends[:, None, 3 * b : 3 * b + 3], number.shape).ravel())
                sources.append(number.ravel())
                signs.append(np.full(number.size, 1.0 if a == b else -1.0))
        turns = (3 * self.hinges[:, :, None] + axes).reshape(-1, 12)
        shape = (len(turns), 12, 12)
        rows.append(np.broadcast_to(turns[:, :, None], shape).ravel())
        columns.append(np.broadcast_to(turns[:, None, :], shape).ravel())
        sources.append(9 * len(ends) + np.arange(144 * len(turns)))
        signs.append(np.ones(144 * len(turns)))
        pulls = (3 * self.pulled[:, None] + axes).ravel()
        rows.append(pulls)
        columns.append(pulls)
        sources.append(9 * len(ends) + 144 * len(turns) + np.arange(len(pulls)))
        signs.append(np.ones(len(pulls)))
        row, column = np.concatenate(rows), np.concatenate(columns)
        place = np.full(3 * len(self.rest), -1)
        place[self.free] = np.arange(len(self.free))
        kept = (place[row] >= 0) & (place[column] >= 0)
        row, column = place[row[kept]], place[column[kept]]
        key = column * len(self.free) + row
        unique, self._target = np.unique(key, return_inverse=True)
        self._rows = (unique % len(self.free)).astype(np.int32)
        counts = np.bincount(unique // len(self.free), minlength=len(self.free))
        self._starts = np.concatenate([[0], np.cumsum(counts)]).astype(np.int32)
        self._source = np.concatenate(sources)[kept]
        self._sign = np.concatenate(signs)[kept]

    def _assembled(self, values: Floats) -> csc_array:
        data = np.bincount(self._target, values[self._source] * self._sign, len(self._rows))
        size = len(self.free)
        return csc_array((data, self._rows, self._starts), shape=(size, size))

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
        return _Bending(curvature, slope, normal, turning, inverse, sound, edge, across)

    def _turning(self, position: Floats, bending: _Bending) -> Floats:
        """Second derivative (h, 12, 12) of the curvature by the nodes' positions.

        The curvature is b.n/|n| with b linear in the positions and n = e x d; its derivatives by b and n,
        through their Jacobians, and the second derivative of n.
        """
        normal, inverse = bending.normal, bending.inverse
        sound = bending.sound.astype(np.float64)
        count = len(normal)
        plane = np.eye(3) - sound[:, None, None] * normal[:, :, None] * normal[:, None, :]
        mixed = plane * inverse[:, None, None]
        sideways = bending.turning  # already over |n|
        outer = normal[:, :, None] * sideways[:, None, :]
        twice = -(sound * inverse)[:, None, None] * (
            (bending.curvature * inverse)[:, None, None] * plane + outer + outer.transpose(0, 2, 1)
        )
        by_edge, by_across = -_cross_matrix(bending.across), _cross_matrix(bending.edge)
        jacobian = np.zeros((count, 2, 3, 4, 3))
        jacobian[:, 0] = np.eye(3)[None, :, None, :] * self.weight[:, None, :, None]
        jacobian[:, 1, :, 0] = -by_edge
        jacobian[:, 1, :, 1] = by_edge
        jacobian[:, 1, :, 2] = by_across
        jacobian[:, 1, :, 3] = -by_across
        sums, normals = jacobian[:, 0].reshape(count, 3, 12), jacobian[:, 1].reshape(count, 3, 12)
        cross = np.matmul(sums.transpose(0, 2, 1), np.matmul(mixed, normals))
        total = cross + cross.transpose(0, 2, 1)
        total += np.matmul(normals.transpose(0, 2, 1), np.matmul(twice, normals))
        # v.(de x dd) = -de.[v]x dd, v = ds/dn.
        skew = -_cross_matrix(sideways)
        signs = ((0, -1.0), (1, 1.0)), ((2, 1.0), (3, -1.0))
        for a, sign_a in signs[0]:
            for b, sign_b in signs[1]:
                block = sign_a * sign_b * skew
                total[:, 3 * a : 3 * a + 3, 3 * b : 3 * b + 3] += block
                total[:, 3 * b : 3 * b + 3, 3 * a : 3 * a + 3] += block.transpose(0, 2, 1)
        return total


class _Bending(NamedTuple):
    curvature: Floats  # (h,) m
    slope: Floats  # (h, 4, 3)
    normal: Floats  # (h, 3)
    turning: Floats  # (h, 3) 1/m, derivative of the curvature by the unnormalised normal
    inverse: Floats  # (h,) 1/m^2, over the length of that
    sound: NDArray[np.bool_]  # (h,) not collapsed
    edge: Floats
    across: Floats


def _cross_matrix(v: Floats) -> Floats:
    """[v]x (h, 3, 3), so that [v]x w = v x w."""
    matrix = np.zeros((len(v), 3, 3))
    matrix[:, 0, 1], matrix[:, 0, 2], matrix[:, 1, 2] = -v[:, 2], v[:, 1], -v[:, 0]
    matrix[:, 1, 0], matrix[:, 2, 0], matrix[:, 2, 1] = v[:, 2], -v[:, 1], v[:, 0]
    return matrix


def settle(
    springs: Springs,
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
    potential = springs.energy(position, stiffness) - float(np.vdot(load, position))
    left, worn = np.inf, factor is None
    for iteration in range(iterations):
        residual = (springs.gradient(position, stiffness) - load).ravel()[springs.free]
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
            reached = springs.energy(moved, stiffness) - float(np.vdot(load, moved))
            # Near the minimum rounding hides how far the potential falls.
            if reached <= potential + _ARMIJO * share * fall + 1e-13 * abs(potential):
                position, potential, worn = moved, reached, False
                break
            share *= 0.5
        else:
            if worn:
                break
            left, worn = np.inf, True  # once more from here with a tangent of this place
    return Settled(position, False, False, iteration + 1), None
