"""Contact points of triangles: a lattice in each, as fine as a tool requires."""

from __future__ import annotations

import math

import numpy as np

from tissue_sim.array_types import Floats, Longs
from tissue_sim.contact.contact_points import Fineness, Lattices
from tissue_sim.contact.touched_surface import TouchedSurface

MAX_SPACING = 0.75  # of a tool's smallest radius: spacing of contact points beyond which the nearest point is added
MIN_DIVISIONS = 2  # a large ball that presses slightly touches an area smaller than a node's
MAX_DIVISIONS = 8


def divisions_of(wanted: float) -> int:
    """Return the number of parts into which contact points divide an edge: rounded up, 2 to 8."""
    return min(max(MIN_DIVISIONS, math.ceil(wanted)), MAX_DIVISIONS)


def lattices() -> Lattices:
    """Return the points of triangles whose edges are divided into up to MAX_DIVISIONS parts."""
    each = [edge_and_face_points(parts) if parts > 1 else np.zeros((0, 3)) for parts in range(MAX_DIVISIONS + 1)]
    weight = np.concatenate(each)
    edge = np.where(np.any(weight == 0.0, axis=1), np.argmin(weight, axis=1), -1)
    return Lattices(weight, edge, np.cumsum([0, *map(len, each)]))


def fineness_of(surface: TouchedSurface, parts: Longs, yielding: Floats) -> Fineness:
    """Return the contact points of triangles, from the number of parts (t,) of their edges and their yielding (t, 2).

    A corner has the mean factor of its triangles, and the smallest of their depths.
    """
    triangles, nodes = surface.triangles, surface.n_points
    in_triangle, at_corner = surface.area_factors()
    count = np.bincount(triangles.ravel(), minlength=nodes)
    total = np.bincount(triangles.ravel(), np.repeat(yielding[:, 0], 3), nodes)
    least = np.full(nodes, np.inf)
    np.minimum.at(least, triangles.ravel(), np.repeat(yielding[:, 1], 3))
    corner = at_corner * (total / np.maximum(count, 1)), np.where(count > 0, least, 0.0)
    yielding = np.stack([in_triangle * yielding[:, 0], yielding[:, 1]], axis=1)
    return Fineness(parts, yielding, np.stack(corner, axis=1))


def edge_and_face_points(m: int) -> Floats:
    """Return barycentric weights (k, 3) of a triangle whose edges have m parts, without the corners."""
    lattice = [(i / m, j / m, (m - i - j) / m) for i in range(m + 1) for j in range(m + 1 - i)]
    return np.array([weights for weights in lattice if max(weights) < 1.0]).reshape(-1, 3)
