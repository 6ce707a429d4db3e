"""Where lines of one direction cross a surface."""

from __future__ import annotations

import numpy as np

from tissue_sim.array_types import Floats
from tissue_sim.organ.organ import Organ


def line_hits(organ: Organ, points: Floats, direction: Floats) -> Floats:
    """Return where lines through points cross the triangles of an organ's surface.

    Parameters
    ----------
    organ : Organ
        The organ.
    points : Floats, shape (k, 3), m
        A point of each line.
    direction : Floats, shape (3,)
        Direction of all lines, of length 1.

    Returns
    -------
    Floats, shape (k, t), m
        Distance from the point along the direction; NaN where a line misses a triangle.

    References
    ----------
    Moeller and Trumbore 1997: Fast, minimum storage ray/triangle intersection.
    """
    corners = organ.surface_positions[organ.surface_triangles]
    a, b, c = (corners[:, corner] for corner in range(3))
    side = np.cross(direction, c - a)
    det = np.einsum("tx,tx->t", b - a, side)
    offset = points[:, None] - a
    with np.errstate(all="ignore"):  # triangles along the direction are never hit
        u = np.einsum("ktx,tx->kt", offset, side) / det
        turned = np.cross(offset, b - a)
        v = turned @ direction / det
        where = np.einsum("ktx,tx->kt", turned, c - a) / det
        hit = (u >= -1e-9) & (v >= -1e-9) & (u + v <= 1.0 + 1e-9) & np.isfinite(where)
    return np.where(hit, where, np.nan)
