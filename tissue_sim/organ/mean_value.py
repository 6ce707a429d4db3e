"""Mean value coordinates (Ju, Schaefer & Warren 2005): what lies inside a closed surface moves with it."""

from __future__ import annotations

import numpy as np

from tissue_sim.array_types import Floats, Ints, Longs

_ON_FACE = 1e-9  # rad, tolerance of half the angle sum about pi, and of a sine


def mean_value_weights(points: Floats, positions: Floats, triangles: Ints | Longs) -> Floats:
    """Return the weights of a closed surface's nodes at points inside it.

    Each row sums to 1 and reproduces the point, so points follow exactly where the surface moves affinely.

    Parameters
    ----------
    points : Floats, shape (p, 3), m
        Points inside.
    positions : Floats, shape (n, 3), m
        Nodes of the surface.
    triangles : Ints | Longs, shape (t, 3)
        Corner indices, counter-clockwise seen from outside.

    Returns
    -------
    Floats, shape (p, n)
        Weights.

    References
    ----------
    Ju, Schaefer & Warren 2005: Mean value coordinates for closed triangular meshes.
    """
    weights = np.zeros((len(points), len(positions)))
    for row, point in zip(weights, points, strict=True):
        _add(row, point, positions, triangles)
    weights /= weights.sum(axis=1, keepdims=True)
    return weights


def _add(row: Floats, point: Floats, positions: Floats, triangles: Ints | Longs) -> None:
    """Add the weights (n,) of one point, triangle by triangle."""
    away = positions - point
    distance = np.linalg.norm(away, axis=1)
    directions = (away / distance[:, None])[triangles]  # (t, 3, 3)
    opposite = np.linalg.norm(np.roll(directions, -1, axis=1) - np.roll(directions, -2, axis=1), axis=2)
    angle = 2.0 * np.arcsin(np.clip(0.5 * opposite, 0.0, 1.0))  # of the side opposite to each corner, seen from here
    half = 0.5 * angle.sum(axis=1)
    following, before = np.roll(angle, -1, axis=1), np.roll(angle, -2, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        cosine = (
            2.0 * np.sin(half)[:, None] * np.sin(half[:, None] - angle) / (np.sin(following) * np.sin(before)) - 1.0
        )
    sign = np.sign(np.linalg.det(directions))[:, None]
    sine = sign * np.sqrt(np.clip(1.0 - cosine**2, 0.0, None))
    # A triangle whose plane goes through the point contributes nothing.
    off_plane = (half < np.pi - _ON_FACE) & (np.abs(sine) > _ON_FACE).all(axis=1)
    cosine, sine, angle, corner = cosine[off_plane], sine[off_plane], angle[off_plane], triangles[off_plane]
    following, before = np.roll(angle, -1, axis=1), np.roll(angle, -2, axis=1)
    next_cosine, last_cosine = np.roll(cosine, -1, axis=1), np.roll(cosine, -2, axis=1)
    found = (angle - next_cosine * before - last_cosine * following) / (
        distance[corner] * np.sin(following) * np.roll(sine, -2, axis=1)
    )
    np.add.at(row, corner, found)
