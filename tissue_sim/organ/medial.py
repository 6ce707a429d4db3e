"""M-rep: what the medial atoms imply about the boundary (Zhang, Gu et al. 2006, section 3.2, equation 2).

Every boundary point C hangs on its nearest atom B by a spoke BC. With A, a neighbour of B on the skeleton,
the tuple {x, r, F(V, AB), theta} holds x = B, r = |BC|, the plane F spanned by the orientation vector
V = AC and AB, and theta, the angle between AB and BC. Then C = x + R_{V,AB}(theta) AB r / |AB|.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from tissue_sim.errors import UserError

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]


@dataclass(frozen=True, eq=False)
class MedialRepresentation:
    """One tuple for each of n spokes: atom B (n,), neighbour A (n,), length r (n,) m, angle theta (n,) rad,
    orientation V (n, 3) m."""

    atom: Ints
    neighbour: Ints
    length: Floats
    theta: Floats
    orientation: Floats


def nearest_atoms(boundary: ArrayLike, atoms: ArrayLike, count: int = 4) -> tuple[Ints, Floats]:
    """The `count` nearest atoms of each boundary point, nearest first: indices (n, count), distances (n, count).

    boundary (n, 3), atoms (a, 3); with fewer atoms than `count`, all of them.
    """
    points, centres = np.asarray(boundary, dtype=np.float64), np.asarray(atoms, dtype=np.float64)
    k = min(count, len(centres))
    distance, index = cKDTree(centres).query(points, k=k)
    return index.reshape(len(points), k).astype(np.int32), distance.reshape(len(points), k)


def neighbours(parent: ArrayLike) -> Ints:
    """The neighbour A of every atom, (a,): its parent, and for a root its first child.

    Raises UserError for an atom without any neighbour.
    """
    towards = np.asarray(parent, dtype=np.int32).copy()
    for root in np.flatnonzero(towards < 0):
        children = np.flatnonzero(np.asarray(parent) == root)
        if len(children) == 0:
            raise UserError(f"medial atom {root} has no neighbour; an M-rep needs two atoms or more")
        towards[root] = children[0]
    return towards


def represent(boundary: ArrayLike, atoms: ArrayLike, parent: ArrayLike) -> MedialRepresentation:
    """The tuples of boundary points (n, 3) m on their nearest atoms (a, 3) m; parent (a,) as in Organ."""
    c, x = np.asarray(boundary, dtype=np.float64), np.asarray(atoms, dtype=np.float64)
    atom = nearest_atoms(c, x, 1)[0][:, 0]
    neighbour = neighbours(parent)[atom]
    along, spoke = x[atom] - x[neighbour], c - x[atom]
    sine = np.linalg.norm(np.cross(along, spoke), axis=1)
    theta = np.arctan2(sine, np.einsum("ij,ij->i", along, spoke))
    return MedialRepresentation(atom, neighbour, np.linalg.norm(spoke, axis=1), theta, c - x[neighbour])


def implied_boundary(atoms: ArrayLike, rep: MedialRepresentation, orientation: ArrayLike | None = None) -> Floats:
    """Equation (2), vectorized: boundary points (n, 3) m that atoms (a, 3) m imply.

    orientation (n, 3): V of every spoke where it has turned with the skeleton; default: as represented.
    """
    x = np.asarray(atoms, dtype=np.float64)
    v = rep.orientation if orientation is None else np.asarray(orientation, dtype=np.float64)
    along = x[rep.atom] - x[rep.neighbour]
    size = np.linalg.norm(along, axis=1, keepdims=True)
    across = _across(along / size, v)
    turned = np.cos(rep.theta)[:, None] * along / size + np.sin(rep.theta)[:, None] * across
    return x[rep.atom] + rep.length[:, None] * turned


def _across(axis: Floats, v: Floats) -> Floats:
    """Unit vector of the plane of axis and v, at right angles to axis; any one where v lies along axis."""
    rest = v - axis * np.einsum("ij,ij->i", axis, v)[:, None]
    size = np.linalg.norm(rest, axis=1, keepdims=True)
    least = np.eye(3)[np.argmin(np.abs(axis), axis=1)]
    other = np.cross(axis, least)
    other /= np.linalg.norm(other, axis=1, keepdims=True)
    scale = np.linalg.norm(v, axis=1, keepdims=True)
    return np.where(size > 1e-9 * scale, rest / np.maximum(size, 1e-300), other)
