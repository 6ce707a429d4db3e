"""Distance from a tool's surface up to which contact points are searched, since it moves until the next search."""

from __future__ import annotations

import numpy as np

from tissue_sim.array_types import Floats
from tissue_sim.contact.tools import MARGIN
from tissue_sim.model.contact.poses import distance_along_path

MAX_MARGIN = 0.01  # m; a tool that is farther from its goal moves there in steps, with a contact set for each


def reach_margins(places: Floats, goals: Floats, last: Floats, fraction: float, extents: Floats) -> Floats:
    """Return the margins beyond MARGIN for bodies that move towards goals.

    A margin covers the distance to the goal, and the possible motion until the next set, which is `fraction` times the
    motion since the last one, as far as both exceed half of MARGIN; it is in whole mm, so that a journal can store it.

    Parameters
    ----------
    places : Floats, shape (T, 7)
        Present poses.
    goals : Floats, shape (T, 7)
        Goals.
    last : Floats, shape (T, 7)
        Goals at the last set.
    fraction : float
        Factor of the motion since the last set.
    extents : Floats, shape (T,), m
        `Shapes.extent`.

    Returns
    -------
    Floats, shape (T,), m
        Margins.
    """
    covered = pose_distances(places, goals, extents) + fraction * pose_distances(last, goals, extents)
    return 1e-3 * np.ceil(1e3 * np.clip(covered - 0.5 * MARGIN, 0.0, MAX_MARGIN))


def pose_distances(poses: Floats, others: Floats, extents: Floats) -> Floats:
    """Return bounds on the distances between the same points of bodies in two poses each.

    Parameters
    ----------
    poses : Floats, shape (T, 7)
        Poses.
    others : Floats, shape (T, 7)
        Other poses.
    extents : Floats, shape (T,), m
        `Shapes.extent`.

    Returns
    -------
    Floats, shape (T,), m
        Bounds.
    """
    return np.array([distance_along_path(*one) for one in zip(poses, others, extents, strict=True)])
