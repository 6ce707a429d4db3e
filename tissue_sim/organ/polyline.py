"""Length along a line of points."""

from __future__ import annotations

import numpy as np

from tissue_sim.array_types import Floats


def arc_length(points: Floats) -> Floats:
    """Return the length along a polyline up to each of its points.

    Parameters
    ----------
    points : Floats, shape (m, d)
        Points of d coordinates.

    Returns
    -------
    Floats, shape (m,)
        Length, in the unit of the points.
    """
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
