"""Where the second derivatives of springs or cells go in a sparse matrix over the free axes, and its factors."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np
from scipy.sparse import csc_array

from tissue_sim.array_types import Floats, Longs
from tissue_sim.calibration.factor import Elimination, Factor


class Pattern:
    """The entries of a symmetric matrix that parts joining nodes add to.

    rest (n, 3) m; free (a,) axes, 3 node + axis, that are the matrix' rows; parts: nodes (k, m) of each kind.
    targets: for each kind the entries (k, m, m, 3, 3) of its parts' second derivatives, -1 for none.
    """

    def __init__(self, rest: Floats, free: Longs, parts: Sequence[Longs]) -> None:
        self._rest, self._free, self._size = rest, free, len(free)
        place = np.full(3 * len(rest), -1)
        place[free] = np.arange(self._size)

        def keys(nodes: Longs) -> Longs:
            """column * size + row."""
            at = place[3 * nodes[:, :, None] + np.arange(3)]
            row, column = at[:, :, None, :, None], at[:, None, :, None, :]
            found: Longs = np.where((row >= 0) & (column >= 0), column * self._size + row, -1)
            return found

        found = [keys(nodes) for nodes in parts]
        unique = np.unique(np.concatenate([part.ravel() for part in found]))
        unique = unique[unique >= 0]
        self._rows = (unique % self._size).astype(np.int32)
        self._starts = np.searchsorted(unique, self._size * np.arange(self._size + 1)).astype(np.int32)
        self.targets = [np.where(part >= 0, np.searchsorted(unique, part), -1) for part in found]

    @property
    def entries(self) -> int:
        """How many entries there are."""
        return len(self._rows)

    def matrix(self, data: Floats) -> csc_array:
        """The matrix (a, a) of these entries."""
        return csc_array((data, self._rows, self._starts), shape=(self._size, self._size))

    def factor(self, matrix: csc_array) -> Factor:
        """A factored matrix of this pattern."""
        return Factor(self._elimination, matrix)

    @cached_property
    def _elimination(self) -> Elimination:
        return Elimination(self._rest, self._free, self._rows, self._starts)
