"""Inside or outside: the winding number of a closed triangle surface."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tissue_sim.array_types import Floats, Ints


def winding_number(points: Floats, positions: Floats, triangles: Ints) -> Floats:
    """Winding number of a closed surface about each point, (p,): 1 inside, 0 outside.

    points (p, 3), positions (n, 3), triangles (t, 3). Sum of the triangles' solid angles
    (van Oosterom & Strackee 1983).
    """
    corners = positions[triangles]
    total = np.empty(len(points))
    for start in range(0, len(points), 256):
        a, b, c = (corners[None, :, k] - points[start : start + 256, None] for k in range(3))
        la, lb, lc = (np.linalg.norm(side, axis=2) for side in (a, b, c))
        numerator = np.einsum("ijk,ijk->ij", a, np.cross(b, c))
        denominator = la * lb * lc
        denominator += np.einsum("ijk,ijk->ij", a, b) * lc
        denominator += np.einsum("ijk,ijk->ij", b, c) * la
        denominator += np.einsum("ijk,ijk->ij", c, a) * lb
        total[start : start + 256] = np.arctan2(numerator, denominator).sum(axis=1) / (2.0 * np.pi)
    return total


def inside(points: Floats, positions: Floats, triangles: Ints) -> NDArray[np.bool_]:
    """Whether each of points (p, 3) lies inside the closed outward surface."""
    return winding_number(points, positions, triangles) > 0.5
