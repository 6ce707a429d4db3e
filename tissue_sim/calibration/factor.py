"""Factored stiffness matrices of springs: the direct solver of the finite elements, for entries instead of elements."""

from __future__ import annotations

from contextlib import suppress
from typing import NamedTuple

import numpy as np
from scipy.sparse import csc_array

from tissue_sim.array_types import Floats, Ints, Longs
from tissue_sim.calibration.cholesky import Cholesky, NotPositive, Pieces, dissect

LEAF = 250  # pairs of nodes that are not divided further: some 25 nodes


class _Entries(NamedTuple):
    """Entries of the matrix that belong to a front, and their rows and columns in it."""

    source: Longs
    column: Longs
    row: Longs


class Elimination:
    """Order in which matrices of one pattern are factored.

    Parameters
    ----------
    positions : Floats, shape (n, 3), m
        Nodes.
    free : Longs, shape (a,)
        Free axes, 3 node + axis, which are the matrices' rows.
    rows : Ints
        Row indices of the pattern, in compressed columns, symmetric.
    starts : Ints, shape (a + 1,)
        Start of each column.
    """

    def __init__(self, positions: Floats, free: Longs, rows: Ints, starts: Ints) -> None:
        n = len(positions)
        self.free, self.size = free, n
        columns = np.repeat(np.arange(len(free)), np.diff(starts))
        row, column = free[rows], free[columns]
        pairs = np.unique(np.stack([row // 3, column // 3], axis=1)[row // 3 >= column // 3], axis=0)
        held = np.ones(3 * n, dtype=bool)
        held[free] = False
        self.fronts = dissect(pairs.astype(np.int32), positions[pairs].mean(axis=1), held.reshape(n, 3), LEAF)
        rank = np.empty(3 * n, dtype=np.int64)
        rank[np.concatenate([front.inside for front in self.fronts])] = np.arange(len(free))
        lower = np.flatnonzero(rank[row] >= rank[column])
        lower = lower[np.argsort(rank[column[lower]], kind="stable")]
        ends = np.cumsum([0, *(len(front.inside) for front in self.fronts)])
        bounds = np.searchsorted(rank[column[lower]], ends)
        place = np.empty(3 * n, dtype=np.int64)
        self._entries: list[_Entries] = []
        for front, first, last in zip(self.fronts, bounds, bounds[1:], strict=False):
            unknowns = np.concatenate([front.inside, front.boundary])
            place[unknowns] = np.arange(len(unknowns))
            source = lower[first:last]
            self._entries.append(_Entries(source, place[column[source]], place[row[source]]))

    def fill(self, number: int, values: Floats, pieces: Pieces) -> None:
        """Add the matrix's entries with these values to a front."""
        diagonal, below, _ = pieces
        source, column, row = self._entries[number]
        inside = row < len(diagonal)
        diagonal[column[inside], row[inside]] += values[source[inside]]
        below[column[~inside], row[~inside] - len(diagonal)] += values[source[~inside]]


class Factor:
    """Factor L L' of a symmetric matrix over the free axes, (a, a); solves many right-hand sides at a time.

    Parameters
    ----------
    order : Elimination
        Order of elimination.
    matrix : csc_array, shape (a, a), N/m
        The matrix.
    """

    def __init__(self, order: Elimination, matrix: csc_array) -> None:
        self._order = order
        values = matrix.data
        self._cholesky: Cholesky | None = None
        with suppress(NotPositive):
            self._cholesky = Cholesky(
                order.fronts, order.size, lambda number, _, pieces: order.fill(number, values, pieces)
            )

    @property
    def is_positive(self) -> bool:
        """Whether the matrix is positive definite; only then it can be solved."""
        return self._cholesky is not None

    def solve(self, right: Floats) -> Floats:
        """Return the solutions of right-hand sides, of the same shape.

        Parameters
        ----------
        right : Floats, shape (a, c) or (a,)
            The right-hand sides.
        """
        assert self._cholesky is not None
        columns = right.reshape(len(right), -1)
        whole = np.zeros((3 * self._order.size, columns.shape[1]))
        whole[self._order.free] = columns
        return self._cholesky.solve(whole)[self._order.free].reshape(right.shape)
