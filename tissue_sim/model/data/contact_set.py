"""Contact set: the surface points that tools may touch, with one layout from the finder to the bag."""

from __future__ import annotations

from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tissue_sim.array_types import Floats, Longs
from tissue_sim.jit import inner, kernel
from tissue_sim.model.data.layout import carve, size_of
from tissue_sim.model.data.records import Record

MAX_CONTACT_POINTS = 2048
POINT_NODES = 4  # largest number of nodes between which a point lies


class Engaged(IntEnum):
    """State of a body in a contact set."""

    # Not searched; may touch; appeared inside; has slipped inside; is in tissue with a blade.
    NO, YES, HELD_OFF, SLIPPED, CUTS = range(5)


class ContactSetHeader(Record):
    """Header of a contact set."""

    sequence: int  # its number
    points: int  # number of points
    dropped: int  # number of points that didn't fit, the farthest ones


class ContactSet(NamedTuple):
    """Surface points that bodies may touch, and those under the bodies' tips; B bodies, at most C points.

    All fields are views of `words`, of which the first `used_words` are the set.
    """

    words: Longs
    header: ContactSetHeader
    engaged: Longs  # (B,) Engaged
    place: Floats  # (B, 7) pose of each body when its points were found; for one that has slipped, its goal
    reach: Floats  # (B,) m by which a body's points may move from there without touching any point outside the set
    n_points: Longs  # (B,) number of its points
    releases: Longs  # (B,) number of its releases and slips at that time
    tip_node: Longs  # (B, 4) nodes between which the point under the tip lies, -1 if none is near
    tip_weight: Floats  # (B, 4) barycentric weights there
    body: Longs  # (C,)
    # Nodes between which each point lies: those of a triangle, with the first repeated, or, at a cut, those of a cell.
    node: Longs  # (C, 4)
    weight: Floats  # (C, 4) barycentric weights, the last one 0 within a triangle
    normal: Floats  # (C, 3) outward unit normals of the tissue
    compliance: Floats  # (C, 2) m/N of the tissue between nodes, along a tool's normal and across it
    most_give: Floats  # (C,) m, largest yielding by this compliance


PER_POINT = ("body", "node", "weight", "normal", "compliance", "most_give")
_POINT = np.dtype(
    [
        ("body", "i8"),
        ("node", "i8", POINT_NODES),
        ("weight", "f8", POINT_NODES),
        ("normal", "f8", 3),
        ("compliance", "f8", 2),
        ("most_give", "f8"),
    ]
)
_POINT_WORDS = _POINT.itemsize // 8
_BETWEEN_NODES = ("node", "weight", "tip_node", "tip_weight")


def _fields(n_bodies: int) -> dict[str, Any]:
    return {
        "header": ContactSetHeader,
        "engaged": (np.int64, (n_bodies,)),
        "place": (np.float64, (n_bodies, 7)),
        "reach": (np.float64, (n_bodies,)),
        "n_points": (np.int64, (n_bodies,)),
        "releases": (np.int64, (n_bodies,)),
        "tip_node": (np.int64, (n_bodies, POINT_NODES)),
        "tip_weight": (np.float64, (n_bodies, POINT_NODES)),
    }


def contact_set_words(n_bodies: int, points: int = MAX_CONTACT_POINTS) -> int:
    """Return the number of words of a contact set.

    Parameters
    ----------
    n_bodies : int
        Number of bodies.
    points : int, optional
        Number of points.
    """
    return size_of(_fields(n_bodies)) + _POINT_WORDS * points


def contact_set(n_bodies: int, points: int = MAX_CONTACT_POINTS, words: Longs | None = None) -> ContactSet:
    """Return an empty contact set.

    Parameters
    ----------
    n_bodies : int
        Number of bodies.
    points : int, optional
        Number of points that it has room for.
    words : Longs | None, shape (contact_set_words(),), optional
        Memory; None for memory of its own.
    """
    if words is None:
        words = np.zeros(contact_set_words(n_bodies, points), dtype=np.int64)
    head: dict[str, Any] = carve(words, _fields(n_bodies))
    rows = words[size_of(_fields(n_bodies)) :].view(_POINT)
    each: dict[str, Any] = {name: rows[name] for name in PER_POINT}
    return ContactSet(words=words, **head, **each)


@kernel
def used_words(contacts: ContactSet) -> int:
    """Return how many words of a contact set are in use.

    Parameters
    ----------
    contacts : ContactSet
        The contact set.
    """
    return len(contacts.words) - _POINT_WORDS * (len(contacts.body) - contacts.header.points)


@inner
def nodes_of(contacts: ContactSet, entry: int) -> int:
    """Return how many of a point's nodes have weights: 3, or 4 where a cut has made the surface.

    Parameters
    ----------
    contacts : ContactSet
        The contact set.
    entry : int
        Index of the point.

    Returns
    -------
    int
        The number; the weights of further ones are 0.
    """
    return POINT_NODES if contacts.weight[entry, POINT_NODES - 1] != 0.0 else POINT_NODES - 1


def padded(name: str, found: NDArray[Any]) -> NDArray[Any]:
    """Return a field of a contact set with POINT_NODES nodes per point; earlier bags have the 3 of a triangle.

    Parameters
    ----------
    name : str
        Name of the field.
    found : NDArray[Any]
        The field.

    Returns
    -------
    NDArray[Any]
        The field with the first node repeated, with weight 0; other fields unchanged.
    """
    if name not in _BETWEEN_NODES or found.ndim != 2 or found.shape[1] != POINT_NODES - 1:
        return found
    more = found[:, :1] if name.endswith("node") else np.zeros_like(found[:, :1])
    return np.concatenate([found, more], axis=1)
