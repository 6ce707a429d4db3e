"""Unloaded shape of an organ of cells, without the weight that it bears in the known shape.

This is the inverse problem of elastostatics: the known shape is the domain, the unloaded one the unknown, and the
equilibrium of Cauchy stress and weight holds in the known shape, whose volumes and gradients are constant [1]_.

References
----------
.. [1] S. Govindjee and P. A. Mihalic, "Computational methods for inverse finite elastostatics", Computer Methods in
   Applied Mechanics and Engineering 136, 1996.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.linalg import splu

from tissue_sim.array_types import Floats, Ints, Mask
from tissue_sim.errors import UserError
from tissue_sim.model.elasticity.cell_law import COMPRESSED, STEEPEST
from tissue_sim.model.elasticity.cells import shapes_of

CLOSE = 1e-11  # residual force relative to the weight at which Newton's method has converged
MOST_STEPS = 60
SHORTEST = 1e-3  # fraction of Newton's step below which the line search is abandoned


class Law(NamedTuple):
    """Material constants of each cell (c,).

    Attributes
    ----------
    mu : Floats, shape (c,), Pa
        Shear modulus.
    lam : Floats, shape (c,), Pa
        Lame's first constant.
    penalty : Floats, shape (c,), J/m^3
        Penalty on a compressed cell.
    """

    mu: Floats
    lam: Floats
    penalty: Floats

    def pressure(self, swollen: Floats) -> tuple[Floats, Floats]:
        """Return the first and second derivative of the energy by the volume ratio (c,), Pa, without mu/2 F:F."""
        bounded, pushed = np.maximum(swollen, STEEPEST), np.minimum(swollen - COMPRESSED, 0.0)
        slope = 0.5 * self.lam * (1.0 + 1.0 / bounded**2) + self.mu / bounded**2
        pressure = 0.5 * self.lam * (bounded - 1.0 / bounded) - self.mu / bounded + slope * (swollen - bounded)
        return pressure + self.penalty * pushed, slope + self.penalty * (pushed < 0.0)


def unloaded_shape(shape: Floats, cells: Ints, law: Law, weight: Floats, free: Mask) -> Floats:
    """Return the positions of the nodes without the weight that they bear in their known shape.

    Parameters
    ----------
    shape : Floats, shape (n, 3), m
        Positions in the known shape.
    cells : Ints, shape (c, 4)
        Node indices of the cells.
    law : Law
        Their material constants.
    weight : Floats, shape (n, 3), N
        Weight that the nodes bear.
    free : Mask, shape (n,)
        Nodes that are not fixed.

    Returns
    -------
    Floats, shape (n, 3), m
        The positions.

    Raises
    ------
    UserError
        If there is no such shape, since the tissue is too soft for the weight.
    """
    inverse = _Inverse(shape, cells, law, weight, free)
    found, off = shape.copy(), inverse.off(shape)
    goal = CLOSE * float(np.linalg.norm(weight[free]))
    for _ in range(MOST_STEPS):
        if np.linalg.norm(off) <= goal:
            return found
        step, length = inverse.step(found, off), 1.0
        while length > SHORTEST:
            tried = found + length * step
            left = inverse.off(tried)
            if np.linalg.norm(left) < np.linalg.norm(off):
                break
            length *= 0.5
        else:
            break
        found, off = tried, left
    raise UserError("no unloaded shape exists: the tissue is too soft for the gravity under which its shape was given")


class _Inverse:
    """Residual forces on free nodes as a function of the unloaded shape, and their derivative."""

    def __init__(self, shape: Floats, cells: Ints, law: Law, weight: Floats, free: Mask) -> None:
        self.cells, self.law, self.weight = cells, law, weight
        self.slope, self.volume = shapes_of(shape, cells)
        self.axes = (3 * np.flatnonzero(free)[:, None] + np.arange(3)).ravel()

    def _deformed(self, unloaded: Floats) -> tuple[Floats, Floats]:
        """Return F (c, 3, 3) and its determinant (c,), which is negative for an inverted cell."""
        back = np.einsum("cai,caj->cij", unloaded[self.cells], self.slope)
        whole = np.linalg.det(back)
        whole = np.where(whole == 0.0, np.nan, whole)
        deformed = np.linalg.inv(np.where(np.isnan(whole)[:, None, None], np.eye(3), back))
        return deformed, 1.0 / whole

    def off(self, unloaded: Floats) -> Floats:
        """Return the residual forces (3 free,) N; infinite if a cell is inverted."""
        deformed, swollen = self._deformed(unloaded)
        if not np.all(swollen > 0.0):
            return np.full(len(self.axes), np.inf)
        stretch = deformed @ deformed.transpose(0, 2, 1)
        pressure, _ = self.law.pressure(swollen)
        stress = (self.law.mu / swollen)[:, None, None] * stretch + pressure[:, None, None] * np.eye(3)
        pull = -self.volume[:, None, None] * np.einsum("cij,caj->cai", stress, self.slope)
        force = self.weight.copy()
        np.add.at(force, self.cells, pull)
        return force.ravel()[self.axes]

    def step(self, unloaded: Floats, off: Floats) -> Floats:
        """Return Newton's step (n, 3) m."""
        deformed, swollen = self._deformed(unloaded)
        stretch = deformed @ deformed.transpose(0, 2, 1)
        scale, (_, steep) = (self.law.mu / swollen)[:, None, None], self.law.pressure(swollen)
        # Derivative of the stress (c, i, k) by the gradient (j, l) of the unloaded shape: dF = -F df F.
        by = np.empty((len(self.cells), 3, 3, 3, 3))
        for j in range(3):
            for one in range(3):
                change = -deformed[:, :, j, None] * deformed[:, None, one, :]
                swelling = -deformed[:, one, j]  # relative change of volume
                both = change @ deformed.transpose(0, 2, 1)
                shear = scale * (both + both.transpose(0, 2, 1) - swelling[:, None, None] * stretch)
                by[:, :, :, j, one] = shear + (steep * swollen * swelling)[:, None, None] * np.eye(3)
        blocks = -np.einsum("c,cikjl,cak,cbl->caibj", self.volume, by, self.slope, self.slope, optimize=True)
        place = 3 * self.cells.astype(np.int64)[:, :, None] + np.arange(3)
        rows = np.broadcast_to(place[:, :, :, None, None], blocks.shape).ravel()
        columns = np.broadcast_to(place[:, None, None, :, :], blocks.shape).ravel()
        size = 3 * len(unloaded)
        slope = coo_array((blocks.ravel(), (rows, columns)), shape=(size, size)).tocsc()[self.axes][:, self.axes]
        step = np.zeros(size)
        step[self.axes] = -splu(slope.tocsc()).solve(off)
        return step.reshape(-1, 3)
