"""M-rep: the boundary that the medial atoms imply (Zhang, Gu et al. 2006, section 3.2, equation 2).

Every boundary point C hangs on its nearest atom B by a spoke BC. With A, a neighbour of B on the skeleton,
the tuple {x, r, F(V, AB), theta} holds x = B, r = |BC|, the plane F spanned by the orientation vector
V = AC and AB, and theta, the angle between AB and BC. Then C = x + R_{V,AB}(theta) AB r / |AB|.

When the atoms move, V has to turn with them, which the paper leaves to future work. Here the skeleton
carries a frame that is transported along it without twist (Bishop 1975; on polylines Bergou et al. 2008):
from one bone to the next it turns by the smallest rotation that keeps it on the bones.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from tissue_sim.array_types import Floats, Ints
from tissue_sim.errors import UserError

_SHORTEST = 1e-12  # m
_HALF_TURN = 1e-12  # square of the sum of two unit vectors that counts as zero
_UNDECIDED = 1e-12  # weight of the identity where the atoms don't determine a rotation


@dataclass(frozen=True, eq=False)
class MedialRepresentation:
    """Tuples of the n spokes, and the skeleton at rest.

    Attributes
    ----------
    atoms : Floats, shape (a, 3), m
        Medial atoms at rest.
    parent : Ints, shape (a,)
        Neighbour towards the root, -1 at the root.
    atom : Ints, shape (n,)
        Atom B of each spoke.
    neighbour : Ints, shape (n,)
        Neighbour A of that atom.
    length : Floats, shape (n,), m
        Length r.
    theta : Floats, shape (n,), rad
        Angle between AB and BC.
    orientation : Floats, shape (n, 3), m
        Vector V = AC.
    """

    atoms: Floats
    parent: Ints
    atom: Ints
    neighbour: Ints
    length: Floats
    theta: Floats
    orientation: Floats


def nearest_atoms(boundary: ArrayLike, atoms: ArrayLike, count: int = 4) -> tuple[Ints, Floats]:
    """Return the atoms nearest to each boundary point, nearest first.

    Parameters
    ----------
    boundary : ArrayLike, shape (n, 3), m
        Boundary points.
    atoms : ArrayLike, shape (a, 3), m
        Atoms.
    count : int, optional
        Number of atoms for each point; with fewer atoms, all of them.

    Returns
    -------
    tuple[Ints, Floats]
        Indices and distances (m), of shape (n, count) each.
    """
    points, centres = np.asarray(boundary, dtype=np.float64), np.asarray(atoms, dtype=np.float64)
    k = min(count, len(centres))
    distance, index = cKDTree(centres).query(points, k=k)
    return index.reshape(len(points), k).astype(np.int32), distance.reshape(len(points), k)


def neighbours(parent: ArrayLike) -> Ints:
    """Return the neighbour A of every atom: its parent, and for a root its first child.

    Parameters
    ----------
    parent : ArrayLike, shape (a,)
        Neighbour towards the root, -1 at the root.

    Returns
    -------
    Ints, shape (a,)
        Indices.

    Raises
    ------
    UserError
        For an atom without any neighbour.
    """
    towards = np.asarray(parent, dtype=np.int32).copy()
    for root in np.flatnonzero(towards < 0):
        children = np.flatnonzero(np.asarray(parent) == root)
        if len(children) == 0:
            raise UserError(f"medial atom {root} has no neighbour; an M-rep needs two atoms or more")
        towards[root] = children[0]
    return towards


def represent(
    boundary: ArrayLike, atoms: ArrayLike, parent: ArrayLike, atom: ArrayLike | None = None
) -> MedialRepresentation:
    """Return the tuples of boundary points.

    Parameters
    ----------
    boundary : ArrayLike, shape (n, 3), m
        Boundary points C.
    atoms : ArrayLike, shape (a, 3), m
        Medial atoms.
    parent : ArrayLike, shape (a,)
        Neighbour towards the root, -1 at the root.
    atom : ArrayLike | None, shape (n,), optional
        Atom B of each spoke; None for the nearest.

    Raises
    ------
    UserError
        For an atom without a neighbour.
    """
    c, x = np.asarray(boundary, dtype=np.float64), np.asarray(atoms, dtype=np.float64)
    atom = nearest_atoms(c, x, 1)[0][:, 0] if atom is None else np.asarray(atom, dtype=np.int32)
    neighbour = neighbours(parent)[atom]
    along, spoke = x[atom] - x[neighbour], c - x[atom]
    sine = np.linalg.norm(np.cross(along, spoke), axis=1)
    theta = np.arctan2(sine, np.einsum("ij,ij->i", along, spoke))
    length = np.linalg.norm(spoke, axis=1)
    return MedialRepresentation(x, np.asarray(parent, dtype=np.int32), atom, neighbour, length, theta, c - x[neighbour])


def implied_boundary(atoms: ArrayLike, rep: MedialRepresentation, orientation: ArrayLike | None = None) -> Floats:
    """Return the boundary points that atoms imply by equation (2).

    Parameters
    ----------
    atoms : ArrayLike, shape (a, 3), m
        Moved atoms.
    rep : MedialRepresentation
        The medial representation at rest.
    orientation : ArrayLike | None, shape (n, 3), m, optional
        V of every spoke, turned with the skeleton; None for V at rest.

    Returns
    -------
    Floats, shape (n, 3), m
        Boundary points.

    References
    ----------
    Zhang, Gu et al. 2006, section 3.2, equation 2.
    """
    x = np.asarray(atoms, dtype=np.float64)
    v = rep.orientation if orientation is None else np.asarray(orientation, dtype=np.float64)
    along = x[rep.atom] - x[rep.neighbour]
    along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), _SHORTEST)
    across = _across(along, v)
    turned = np.cos(rep.theta)[:, None] * along + np.sin(rep.theta)[:, None] * across
    return x[rep.atom] + rep.length[:, None] * turned


def recalculated_boundary(rep: MedialRepresentation, atoms: ArrayLike) -> Floats:
    """Return the boundary points that the moved atoms imply, twist-free along the skeleton.

    A rigid motion of the atoms moves the boundary with them; about the axis of a straight skeleton, where the atoms
    can't determine it, the boundary doesn't turn. Usable as the target of the model's return springs.

    Parameters
    ----------
    rep : MedialRepresentation
        The medial representation at rest.
    atoms : ArrayLike, shape (a, 3), m
        Moved atoms.

    Returns
    -------
    Floats, shape (n, 3), m
        Boundary points.
    """
    turn = transported_frames(rep.atoms, atoms, rep.parent)
    return implied_boundary(atoms, rep, np.einsum("nij,nj->ni", turn[rep.atom], rep.orientation))


def transported_frames(rest: ArrayLike, moved: ArrayLike, parent: ArrayLike) -> Floats:
    """Return the rotation of each atom's frame between two states of the skeleton.

    The root turns as the skeleton does as a whole (Kabsch 1976), then each frame by the smallest
    rotation that takes its bone from where the parent's frame would carry it to where it is.
    """
    before, after = np.asarray(rest, dtype=np.float64), np.asarray(moved, dtype=np.float64)
    towards, up = neighbours(parent), np.asarray(parent)
    old, new = _directions(before - before[towards]), _directions(after - after[towards])
    frames = np.empty((len(before), 3, 3))
    whole = nearest_rotation(before, after)
    for i in range(len(before)):
        carried = whole if up[i] < 0 else frames[up[i]]
        start = _directions((carried @ old[i])[None])[0]  # rounding would grow from bone to bone
        frames[i] = smallest_rotation(start, new[i]) @ carried if new[i].any() else carried
    return frames


def nearest_rotation(before: Floats, after: Floats) -> Floats:
    """Return the rotation (3, 3) that takes points (a, 3) nearest to others (Kabsch 1976), with little twist.

    Points of a rigid motion give that motion's rotation exactly. The more they have moved otherwise, the more weight
    has the rotation that moves the axis without turning about it: a slender skeleton that is bent has not been twisted.
    About a straight line it never turns.
    """
    a, b = before - before.mean(axis=0), after - after.mean(axis=0)
    spread = b.T @ a
    u, size, vt = np.linalg.svd(spread)
    straight = smallest_rotation(vt[0], u[:, 0])
    turned = _proper(u, vt) if size[1] > _UNDECIDED * size[0] else straight
    misfit = float(np.sum((b - a @ turned.T) ** 2)) + _UNDECIDED * float(size[0])
    u, _, vt = np.linalg.svd(spread + misfit * straight)
    return _proper(u, vt)


def _proper(u: Floats, vt: Floats) -> Floats:
    """Return the rotation next to u vt, never a reflection."""
    turned = u * np.array([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    return turned @ vt


def smallest_rotation(source: Floats, target: Floats) -> Floats:
    """Return the rotation (3, 3) by the smallest angle from one unit vector to another; half a turn takes any axis."""
    middle = source + target
    square = float(middle @ middle)
    if square < _HALF_TURN:
        axis = _across(source[None], np.eye(3)[[np.argmin(np.abs(source))]])[0]
        return 2.0 * np.outer(axis, axis) - np.eye(3)
    return np.eye(3) - 2.0 / square * np.outer(middle, middle) + 2.0 * np.outer(target, source)


def _directions(bones: Floats) -> Floats:
    """Return unit vectors; a bone of zero length keeps a zero vector, and its frame is its parent's."""
    return bones / np.maximum(np.linalg.norm(bones, axis=1, keepdims=True), _SHORTEST)


def _across(axis: Floats, v: Floats) -> Floats:
    """Return the unit vector in the plane of axis and v that is perpendicular to axis; any one where v is parallel."""
    rest = v - axis * np.einsum("ij,ij->i", axis, v)[:, None]
    size = np.linalg.norm(rest, axis=1, keepdims=True)
    least = np.eye(3)[np.argmin(np.abs(axis), axis=1)]
    other = np.cross(axis, least)
    other /= np.maximum(np.linalg.norm(other, axis=1, keepdims=True), _SHORTEST)
    scale = np.linalg.norm(v, axis=1, keepdims=True)
    return np.where(size > 1e-9 * scale, rest / np.maximum(size, 1e-300), other)
