"""Volumes of many tetrahedra, with the same additions and products on every processor."""

from __future__ import annotations

import numpy as np

from tissue_sim.array_types import Floats


def triple_product(a: Floats, b: Floats, c: Floats) -> Floats:
    """Return a (b x c) of vectors: six times the volume of the tetrahedra that they span.

    The last bits of LAPACK and BLAS differ between processors, while a replay must repeat on any of them.

    Parameters
    ----------
    a : Floats, shape (k, 3), m
        First edges.
    b : Floats, shape (k, 3), m
        Second edges.
    c : Floats, shape (k, 3), m
        Third edges.

    Returns
    -------
    Floats
        shape (k,), m^3
    """
    x, y, z = (a * np.cross(b, c)).T
    return np.asarray(x + y + z)
