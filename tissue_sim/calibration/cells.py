"""Energy, forces and tangents of cells whose moduli are arguments; model.cells has the law, without its penalty."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.sparse import csc_array

from tissue_sim.array_types import Floats
from tissue_sim.calibration.factor import Factor
from tissue_sim.calibration.pattern import Pattern
from tissue_sim.model.assembly import Model
from tissue_sim.model.cells import STEEPEST, shapes_of
from tissue_sim.model.modes import free_axes

_AXES = np.arange(3)
_AT_A_TIME = 64


class Cells:
    """The cells of a model as functions of position and moduli: what a fit asks of `static.Springs`, too.

    Moduli (2c,) Pa stand in one array: mu of every cell, then lambda. Of the model only topology and rest shape count.
    """

    def __init__(self, model: Model) -> None:
        self.rest, self.n_surface, self.free = model.rest, model.n_surface, free_axes(model)
        self.nodes = model.cells[:, [1, 0, 2, 3]].astype(np.int64)
        # Of the shape function of each node, (c, 4, 3) 1/m.
        self._slope, self.volume = shapes_of(self.rest, self.nodes)
        self.counts = (len(self.nodes), len(self.nodes))
        self._along = np.einsum("cax,cbx->cab", self._slope, self._slope)
        self._across = np.cross(self._slope[:, :, None], self._slope[:, None, :])
        self._pattern = Pattern(self.rest, self.free, (self.nodes,))
        self._place = np.full(3 * len(self.rest), -1)  # the last row, without anything, of what is held
        self._place[self.free] = np.arange(len(self.free))
        target = self._pattern.targets[0].ravel()
        self._target = np.where(target >= 0, target, self._pattern.entries)  # past the end: of held nodes

    def trace(self) -> Floats:
        """What a unit of each modulus (2c,) adds to the trace of the tangent at rest."""
        size = self.volume * np.einsum("caa->c", self._along)
        return np.concatenate([4.0 * size, size])

    # energy and forces -------------------------------------------------------------------------
    def energy_and_gradient(self, position: Floats, moduli: Floats) -> tuple[float, Floats]:
        """Elastic energy, J, and its gradient (n, 3) N: the force that must be applied to hold the shape."""
        mu, lam = self._split(moduli)
        at = self._look(position)
        square = np.einsum("cij,cij->c", at.gradient, at.gradient)
        bounded, under, logarithm = at.bounded, at.under, np.log(at.bounded)
        by_mu = 0.5 * (square - 3.0) - logarithm - under / bounded + 0.5 * (under / STEEPEST) ** 2
        by_lam = 0.25 * (bounded**2 - 1.0) - 0.5 * logarithm + 0.5 * (bounded - 1.0 / bounded) * under
        by_lam += 0.25 * (1.0 + 1.0 / STEEPEST**2) * under**2
        stress = mu[:, None, None] * at.gradient + (mu * at.by_mu + lam * at.by_lam)[:, None, None] * at.cofactor
        push = np.einsum("c,cij,caj->cai", self.volume, stress, self._slope)
        gradient = np.zeros_like(position)
        for axis in range(3):
            gradient[:, axis] = np.bincount(self.nodes.ravel(), push[:, :, axis].ravel(), len(position))
        return float(self.volume @ (mu * by_mu + lam * by_lam)), gradient

    def sensitivity(self, position: Floats, direction: Floats) -> Floats:
        """What each modulus adds to the energy gradient along a direction (n, 3): (2c,)."""
        at = self._look(position)
        change = np.einsum("cai,caj->cij", direction[self.nodes], self._slope)
        swelling = np.einsum("cij,cij->c", at.cofactor, change)
        by_mu = np.einsum("cij,cij->c", at.gradient, change) + at.by_mu * swelling
        return np.concatenate([self.volume * by_mu, self.volume * at.by_lam * swelling])

    # tangents ----------------------------------------------------------------------------------
    def tangent(self, position: Floats, moduli: Floats, convex: bool = False) -> csc_array:
        """Second derivative of the energy over the free axes, (a, a) N/m.

        convex: without what the pressure's turning takes from it, so that the matrix is positive definite.
        """
        mu, lam = self._split(moduli)
        at = self._look(position)
        normal = np.einsum("cij,caj->cai", at.cofactor, self._slope)  # of J by each node, 1/m
        steep = mu / at.bounded**2 + 0.5 * lam * (1.0 + 1.0 / at.bounded**2)
        block = np.einsum("c,cai,cbj->cabij", steep, normal, normal, optimize=True)
        block[:, :, :, _AXES, _AXES] += (mu[:, None, None] * self._along)[..., None]
        if not convex:
            turned = np.einsum("c,cij,cabj->cabi", mu * at.by_mu + lam * at.by_lam, at.gradient, self._across)
            for i in range(3):
                j, k = (i + 1) % 3, (i + 2) % 3
                block[:, :, :, j, k] += turned[..., i]
                block[:, :, :, k, j] -= turned[..., i]
        block *= self.volume[:, None, None, None, None]
        return self._pattern.matrix(np.bincount(self._target, block.ravel(), self._pattern.entries + 1)[:-1])

    def factor(self, tangent: csc_array) -> Factor:
        """A factored tangent."""
        return self._pattern.factor(tangent)

    def rest_tangent(self, moduli: Floats) -> csc_array:
        """The tangent at rest: that of linear elasticity."""
        return self.tangent(self.rest, moduli)

    def rest_sensitivity(self, answer: Floats, adjoint: Floats) -> Floats:
        """What each modulus (2c,) adds to the work that rest_tangent answer does along adjoint; both (a, r).

        A few cells at a time, so that what is gathered for them stays in the processor.
        """
        axes = self._place[3 * self.nodes[:, :, None] + _AXES].reshape(len(self.nodes), 12)
        by_mu, by_lam = np.empty(len(axes)), np.empty(len(axes))
        here, there = (np.concatenate([part, np.zeros((1, part.shape[1]))]) for part in (answer, adjoint))
        for first in range(0, len(axes), _AT_A_TIME):
            some = slice(first, first + _AT_A_TIME)
            work = there[axes[some]] @ here[axes[some]].transpose(0, 2, 1)
            work = work.reshape(-1, 4, 3, 4, 3)
            slope = self._slope[some]
            by_mu[some] = np.einsum("cab,caibi->c", self._along[some], work)
            by_mu[some] += np.einsum("caibj,caj,cbi->c", work, slope, slope, optimize=True)
            by_lam[some] = np.einsum("caibj,cai,cbj->c", work, slope, slope, optimize=True)
        return np.concatenate([self.volume * by_mu, self.volume * by_lam])

    def least_volume(self, position: Floats) -> float:
        """Least J of a cell: its volume over that at rest."""
        return float(np.linalg.det(self._gradient(position)).min())

    def _split(self, moduli: Floats) -> tuple[Floats, Floats]:
        return moduli[: len(self.nodes)], moduli[len(self.nodes) :]

    def _gradient(self, position: Floats) -> Floats:
        return np.einsum("cai,caj->cij", position[self.nodes], self._slope)

    def _look(self, position: Floats) -> _Shape:
        gradient = self._gradient(position)
        rows = [np.cross(gradient[:, (i + 1) % 3], gradient[:, (i + 2) % 3]) for i in range(3)]
        cofactor = np.stack(rows, axis=1)
        swollen = np.einsum("cj,cj->c", gradient[:, 0], rows[0])
        bounded = np.maximum(swollen, STEEPEST)
        under = swollen - bounded
        by_mu = under / STEEPEST**2 - 1.0 / bounded
        by_lam = 0.5 * (bounded - 1.0 / bounded) + 0.5 * (1.0 + 1.0 / STEEPEST**2) * under
        return _Shape(gradient, cofactor, bounded, under, by_mu, by_lam)


class _Shape(NamedTuple):
    """Of every cell."""

    gradient: Floats  # (c, 3, 3) of the deformation
    cofactor: Floats  # (c, 3, 3)
    bounded: Floats  # (c,) J, STEEPEST at the least
    under: Floats  # (c,) by how much J is less
    by_mu: Floats  # (c,) slope of the energy density by J over mu, without that of F:F
    by_lam: Floats  # (c,) and over lambda
