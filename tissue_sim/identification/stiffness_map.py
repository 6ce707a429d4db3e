"""Map of stiffness over places, between which it is interpolated."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from tissue_sim.array_types import Floats

NEIGHBOURS = 4
BLUNT = 0.15  # of the tool's radius: distance below which places count alike
REACH = 2.0  # distances between neighbouring places, at which the map has decayed to 1 / e


def interpolated(points: Floats, values: Floats, at: Floats, radius: float) -> Floats:
    """Return values between places: the mean of the nearest four, weighed by their inverse squared distance.

    Parameters
    ----------
    points : Floats, shape (n, 3), m
        Places.
    values : Floats, shape (n,)
        Values there.
    at : Floats, shape (m, 3), m
        Where values are wanted.
    radius : float, m
        Radius of the tool.

    Returns
    -------
    Floats, shape (m,)
        Interpolated values (Shepard 1968).
    """
    near = min(NEIGHBOURS, len(points))
    apart, index = cKDTree(points).query(at, near)
    apart, index = apart.reshape(len(at), near), index.reshape(len(at), near)
    weight = 1.0 / (apart + BLUNT * radius) ** 2
    return np.asarray((weight * values[index]).sum(axis=1) / weight.sum(axis=1))


def spacing_of(points: Floats) -> float:
    """Return the median distance of places (n, 3) m from their nearest neighbour, m."""
    return float(np.median(cKDTree(points).query(points, 2)[0][:, 1]))


def decaying(points: Floats, values: Floats, at: Floats, radius: float) -> Floats:
    """Return `interpolated`, less far from all places, where nothing was measured."""
    apart = cKDTree(points).query(at)[0]
    fade = np.exp(-((apart / (REACH * max(spacing_of(points), radius))) ** 2))
    return np.asarray(fade * interpolated(points, values, at, radius))
