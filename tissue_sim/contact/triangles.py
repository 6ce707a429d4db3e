"""Nearest points of triangles."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from tissue_sim.array_types import Floats, Longs
from tissue_sim.jit import kernel

TIED = 1e-9  # of a squared distance
FLAT = 1e-7  # ratio of height to edge below which only a triangle's edges count


def closest_points(corners: Floats, points: Floats) -> Floats:
    """Return the nearest point of each triangle to its point.

    Parameters
    ----------
    corners : Floats, shape (k, 3, 3), m
        Corners of the triangles.
    points : Floats, shape (k, 3), m
        Points.

    Returns
    -------
    Floats, shape (k, 3), m
        Nearest points.
    """
    weights, _ = nearest_weights(corners, points)
    return np.einsum("kc,kcx->kx", weights, corners)


def nearest_weights(corners: Floats, points: Floats) -> tuple[Floats, Floats]:
    """Return the nearest point of each triangle to its point, as barycentric weights.

    Parameters
    ----------
    corners : Floats, shape (k, 3, 3), m
        Corners of the triangles.
    points : Floats, shape (k, 3), m
        Points.

    Returns
    -------
    tuple[Floats, Floats]
        Weights, shape (k, 3), none of them negative, and distances, shape (k,), m.
    """
    weights, distances = np.empty((len(corners), 3)), np.empty(len(corners))
    # Strided and read-only arrays would be compiled separately.
    corners, points = (np.ascontiguousarray(given, dtype=np.float64) for given in (corners, points))
    _find_nearest(corners, points, weights, distances)
    return weights, distances


@kernel
def _find_nearest(corners: Floats, points: Floats, weights: Floats, distances: Floats) -> None:
    """Compute what `nearest_weights` returns."""
    for t in range(len(corners)):
        nearest_of_face(corners[t], points[t], weights[t])
        square = 0.0
        for c in range(3):
            at = weights[t, 0] * corners[t, 0, c] + weights[t, 1] * corners[t, 1, c] + weights[t, 2] * corners[t, 2, c]
            square += (points[t, c] - at) ** 2
        distances[t] = math.sqrt(square)


def nearest_among(corners: Floats, points: Floats) -> tuple[Longs, Floats, Floats]:
    """Return the triangle nearest to each point.

    If triangles share the nearest place, it is the one whose normal is closest to the direction of the point, so that
    this normal distinguishes inside from outside.

    Parameters
    ----------
    corners : Floats, shape (t, 3, 3), m
        Corners of the triangles.
    points : Floats, shape (k, 3), m
        Points.

    Returns
    -------
    tuple[Longs, Floats, Floats]
        Triangles, shape (k,), barycentric weights of the places, shape (k, 3), and distances, shape (k,), m.
    """
    found = _Nearest(np.zeros(len(points), dtype=np.int64), np.zeros((len(points), 3)), np.zeros(len(points)))
    corners, points = (np.ascontiguousarray(given, dtype=np.float64) for given in (corners, points))
    _find_nearest_among(corners, points, np.zeros((len(corners), 7)), np.zeros(3), found)
    return found.number, found.weights, found.distances


class _Nearest(NamedTuple):
    """Buffers for the places nearest to points."""

    number: Longs  # (k,) indices of the triangles on which they lie
    weights: Floats  # (k, 3) barycentric
    distances: Floats  # (k,) m


@kernel
def _find_nearest_among(corners: Floats, points: Floats, about: Floats, weight: Floats, found: _Nearest) -> None:
    """Compute what `nearest_among` returns; about (t, 7): buffer for centres, radii and unit normals."""
    for t in range(len(corners)):
        _survey(corners[t], about[t])
    for k in range(len(points)):
        least = reach = steepest = math.inf
        for t in range(len(corners)):
            x, y, z = points[k, 0] - about[t, 0], points[k, 1] - about[t, 1], points[k, 2] - about[t, 2]
            bound = reach + about[t, 3]
            if x * x + y * y + z * z > bound * bound:
                continue
            nearest_of_face(corners[t], points[k], weight)
            square = height = 0.0
            for c in range(3):
                at = weight[0] * corners[t, 0, c] + weight[1] * corners[t, 1, c] + weight[2] * corners[t, 2, c]
                square += (points[k, c] - at) ** 2
                height += (points[k, c] - at) * about[t, 4 + c]
            if square > least * (1.0 + TIED) or (square >= least * (1.0 - TIED) and abs(height) <= steepest):
                continue
            least, steepest, reach = min(square, least), abs(height), math.sqrt(square) * (1.0 + TIED)
            found.number[k] = t
            for c in range(3):
                found.weights[k, c] = weight[c]
        found.distances[k] = math.sqrt(least)


@kernel
def _survey(corner: Floats, about: Floats) -> None:
    """Write a triangle's centre (3,), the farthest corner's distance from it, and its unit normal (3,)."""
    square = 0.0
    for c in range(3):
        about[c] = (corner[0, c] + corner[1, c] + corner[2, c]) / 3.0
    for k in range(3):
        far = 0.0
        for c in range(3):
            far += (corner[k, c] - about[c]) ** 2
        square = max(square, far)
    about[3] = math.sqrt(square)
    size = 0.0
    for c in range(3):
        b, d = (c + 1) % 3, (c + 2) % 3
        about[4 + c] = (corner[1, b] - corner[0, b]) * (corner[2, d] - corner[0, d])
        about[4 + c] -= (corner[1, d] - corner[0, d]) * (corner[2, b] - corner[0, b])
        size += about[4 + c] ** 2
    for c in range(3):
        about[4 + c] /= max(math.sqrt(size), 1e-300)


@kernel
def nearest_of_face(corner: Floats, point: Floats, weight: Floats) -> None:
    """Compute the barycentric weights of the point's projection, or of the nearest place on the edges.

    Parameters
    ----------
    corner : Floats, shape (3, 3), m
        Corners of the triangle.
    point : Floats, shape (3,), m
        The point.
    weight : Floats, shape (3,)
        Receives the weights.
    """
    ax, ay, az = corner[1, 0] - corner[0, 0], corner[1, 1] - corner[0, 1], corner[1, 2] - corner[0, 2]
    bx, by, bz = corner[2, 0] - corner[0, 0], corner[2, 1] - corner[0, 1], corner[2, 2] - corner[0, 2]
    px, py, pz = point[0] - corner[0, 0], point[1] - corner[0, 1], point[2] - corner[0, 2]
    nx, ny, nz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    square = nx * nx + ny * ny + nz * nz
    longest = max(ax * ax + ay * ay + az * az, bx * bx + by * by + bz * bz)
    if square > (FLAT * longest) ** 2:
        v = (nx * (py * bz - pz * by) + ny * (pz * bx - px * bz) + nz * (px * by - py * bx)) / square
        w = (nx * (ay * pz - az * py) + ny * (az * px - ax * pz) + nz * (ax * py - ay * px)) / square
        u = 1.0 - v - w
        if min(u, v, w) >= 0.0:
            weight[0], weight[1], weight[2] = u, v, w
            return
    least = math.inf
    for c in range(3):
        fraction, apart = _nearest_of_edge(corner[c], corner[(c + 1) % 3], point)
        if apart < least:
            least = apart
            weight[c], weight[(c + 1) % 3], weight[(c + 2) % 3] = 1.0 - fraction, fraction, 0.0


@kernel
def _nearest_of_edge(start: Floats, end: Floats, point: Floats) -> tuple[float, float]:
    """Return the fraction from start to end (3,) where an edge is nearest to a point, and the squared distance, m^2."""
    along = length = 0.0
    for c in range(3):
        along += (end[c] - start[c]) * (point[c] - start[c])
        length += (end[c] - start[c]) ** 2
    fraction = 0.0 if length == 0.0 else min(max(along / length, 0.0), 1.0)
    apart = 0.0
    for c in range(3):
        apart += (start[c] + fraction * (end[c] - start[c]) - point[c]) ** 2
    return fraction, apart
