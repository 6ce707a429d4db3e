"""What lies inside a closed surface goes with it: mean value coordinates (Ju, Schaefer & Warren 2005)."""

from __future__ import annotations

import numpy as np

from tissue_sim.array_types import Floats, Ints, Longs

_ON_FACE = 1e-9  # rad, of a half angle's sum off pi, and of a sine


def mean_value_weights(points: Floats, positions: Floats, triangles: Ints | Longs) -> Floats:
    """Weights (p, n) of a surface's nodes, positions (n, 3), triangles (t, 3), at points (p, 3) inside it.

    Each row sums to 1, and gives back the point; so points go along exactly where the surface moves affinely.
    """
    weights = np.zeros((len(points), len(positions)))
    for row, point in zip(weights, points, strict=True):
        _add(row, point, positions, triangles)
    weights /= weights.sum(axis=1, keepdims=True)
    return weights


def _add(row: Floats, point: Floats, positions: Floats, triangles: Ints | Longs) -> None:
    """Add up the weights (n,) of one point, by triangles."""
    away = positions - point
    distance = np.linalg.norm(away, axis=1)
    ways = (away / distance[:, None])[triangles]  # (t, 3, 3)
    opposite = np.linalg.norm(np.roll(ways, -1, axis=1) - np.roll(ways, -2, axis=1), axis=2)
    angle = 2.0 * np.arcsin(np.clip(0.5 * opposite, 0.0, 1.0))  # of the side opposite to each corner, seen from here
    half = 0.5 * angle.sum(axis=1)
    following, before = np.roll(angle, -1, axis=1), np.roll(angle, -2, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        cosine = (
            2.0 * np.sin(half)[:, None] * np.sin(half[:, None] - angle) / (np.sin(following) * np.sin(before)) - 1.0
        )
    sign = np.sign(np.linalg.det(ways))[:, None]
    sine = sign * np.sqrt(np.clip(1.0 - cosine**2, 0.0, None))
    # A triangle whose plane goes through the point says nothing.
    told = (half < np.pi - _ON_FACE) & (np.abs(sine) > _ON_FACE).all(axis=1)
    cosine, sine, angle, corner = cosine[told], sine[told], angle[told], triangles[told]
    following, before = np.roll(angle, -1, axis=1), np.roll(angle, -2, axis=1)
    next_cosine, last_cosine = np.roll(cosine, -1, axis=1), np.roll(cosine, -2, axis=1)
    found = (angle - next_cosine * before - last_cosine * following) / (
        distance[corner] * np.sin(following) * np.roll(sine, -2, axis=1)
    )
    np.add.at(row, corner, found)
