"""Diagonal matrices; SciPy before 1.12, which Ubuntu 24.04 has, makes no sparse arrays of them by itself."""

from __future__ import annotations

from scipy.sparse import dia_array

from tissue_sim.array_types import Floats


def diagonal(values: Floats) -> dia_array:
    """The matrix (n, n) with the values (n,) on its diagonal, sparse."""
    return dia_array((values[None], [0]), shape=(len(values), len(values)))
