"""Diagonal matrices; SciPy before 1.12, which Ubuntu 24.04 has, can't make sparse arrays of them."""

from __future__ import annotations

from scipy.sparse import dia_array

from tissue_sim.array_types import Floats


def diagonal(values: Floats) -> dia_array:
    """Return a sparse diagonal matrix.

    Parameters
    ----------
    values : Floats, shape (n,)
        The diagonal.

    Returns
    -------
    dia_array, shape (n, n)
        The matrix.
    """
    return dia_array((values[None], [0]), shape=(len(values), len(values)))
