"""Directions across others."""

from __future__ import annotations

import numpy as np

from tissue_sim.array_types import Floats


def across(directions: Floats) -> Floats:
    """Return two unit vectors across each of some unit vectors, the second one also across the first.

    Parameters
    ----------
    directions : Floats, shape (..., 3)
        Unit vectors.

    Returns
    -------
    Floats, shape (2, ..., 3)
        The first ones and the second ones; zero across a zero vector.
    """
    # The axis that a direction is farthest from is never along it.
    first = np.cross(directions, np.eye(3)[np.argmin(np.abs(directions), axis=-1)])
    first /= np.maximum(np.linalg.norm(first, axis=-1, keepdims=True), np.finfo(np.float64).tiny)
    return np.stack([first, np.cross(directions, first)])
