"""Tangent of springs or cells about rest, as a function of their stiffness, for a fit."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csc_array, csr_array

from tissue_sim.array_types import Floats, Longs
from tissue_sim.calibration.factor import Elimination, Factor
from tissue_sim.model.data.model import Model
from tissue_sim.model.elasticity.modes import free_axes, strains_of

_AT_A_TIME = 512  # entries whose products are summed at once, so that they stay in the cache


class Elastic:
    """Model about rest as a function of stiffness (p,), in the order of model.modes.strains_of.

    Its tangent is linear in stiffness: the matrix' entries are a table times it. Of the model only topology, rest shape
    and rest lengths count, not its stiffness, which is in `stiffness`.

    Parameters
    ----------
    model : Model
        The model.
    """

    def __init__(self, model: Model) -> None:
        strains = strains_of(model)
        self.stiffness = strains.stiffness
        self.n_nodes, self.n_surface, self.free = len(model.rest), model.n_surface, free_axes(model)
        self.moving = np.zeros(self.n_nodes, dtype=bool)  # nodes that may move
        self.moving[self.free[::3] // 3] = True
        square = np.asarray(strains.rows.power(2).sum(axis=1)).ravel()
        self._trace = np.bincount(strains.owner, square, len(self.stiffness))
        self.rows, self.owner = strains.rows.tocsr()[:, self.free], strains.owner
        row, column, self._table = _table(self.rows, self.owner, len(self.stiffness))
        starts = np.searchsorted(column, np.arange(len(self.free) + 1)).astype(np.int32)
        self._entries = row, column
        self._pattern = row.astype(np.int32), starts
        self._elimination = Elimination(model.rest, self.free, *self._pattern)

    def trace(self) -> Floats:
        """Return the contribution of a unit of each stiffness (p,) to the trace of the tangent, held nodes included."""
        return self._trace

    def tangent(self, stiffness: Floats) -> csc_array:
        """Return the stiffness matrix over the free axes, (a, a) N/m.

        Parameters
        ----------
        stiffness : Floats, shape (p,)
            Stiffness of every spring or cell.
        """
        size = len(self.free)
        return csc_array((self._table @ stiffness, *self._pattern), shape=(size, size))

    def factor(self, tangent: csc_array) -> Factor:
        """Return a factorised tangent.

        Parameters
        ----------
        tangent : csc_array, shape (a, a), N/m
            The tangent.
        """
        return Factor(self._elimination, tangent)

    def sensitivity(self, answer: Floats, adjoint: Floats) -> Floats:
        """Return the slope (p,), by each stiffness, of the work of tangent times answer along adjoint.

        Parameters
        ----------
        answer : Floats, shape (a, r)
            The answer.
        adjoint : Floats, shape (a, r)
            The adjoint.
        """
        row, column = self._entries
        work = np.empty(len(row))
        for first in range(0, len(row), _AT_A_TIME):
            some = slice(first, first + _AT_A_TIME)
            work[some] = np.einsum("er,er->e", adjoint[row[some]], answer[column[some]])
        slope: Floats = self._table.T @ work
        return slope


def _table(rows: csr_array, owner: Longs, count: int) -> tuple[Longs, Longs, csr_array]:
    """Return rows and columns (e,) of a tangent's entries, column by column, and each stiffness's factors in them."""
    size, parts = rows.shape[1], []
    lengths = np.diff(rows.indptr)
    for length in np.unique(lengths[lengths > 0]):
        some = np.flatnonzero(lengths == length)
        place = rows.indptr[some][:, None] + np.arange(length)
        axis, value = rows.indices[place].astype(np.int64), rows.data[place]
        key = axis[:, None, :] * size + axis[:, :, None]
        product = value[:, None, :] * value[:, :, None]
        parts.append((key.ravel(), product.ravel(), np.repeat(owner[some], length**2)))
    key, product, by = (np.concatenate(part) for part in zip(*parts, strict=True))
    entry, where = np.unique(key, return_inverse=True)
    table = csr_array((product, (where.ravel(), by)), shape=(len(entry), count))
    return entry % size, entry // size, table
