"""Pairs of places where organs touch: as they are found, and as they are applied, with their forces.

A pair is a node of one organ and a triangle of another. The walls and lips of a cut have points between nodes: such a
cut point is part of a set, and is given as -1 minus its index there instead of a node. It depends on the nodes that
the organ had after that cut, so pairs with such points are dropped when the organ continues with another cut.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tissue_sim.array_types import Floats, Longs
from tissue_sim.jit import kernel
from tissue_sim.model.data.arrays import copy
from tissue_sim.model.data.contact_set import POINT_NODES
from tissue_sim.model.data.records import Record, Vector

MAX_PAIRS = 4096
MAX_CUT_POINTS = 4096
MAX_ORGANS = 16
MAX_BEARERS = 2 * POINT_NODES  # nodes of both organs that bear a pair's force


class OrganContactSet(NamedTuple):
    """Up to MAX_PAIRS pairs of a node of organ[0] and a triangle of organ[1], in the order of organs and nodes.

    Cut points are ordered in the same way. As nodes of pairs they come after all others, by their numbers.
    """

    words: Longs  # memory of the other fields
    found: Longs  # (1,) number of pairs
    organ: Longs  # (p, 2)
    node: Longs  # (p, 4) the node, and the triangle's three; below 0: a cut point, -1 minus its index
    weight: Floats  # (p, 3) barycentric, of the place on the triangle that is nearest to the node
    points: Longs  # (1,) number of cut points
    point_organ: Longs  # (q,)
    point_number: Longs  # (q,) in the surface of the cut organ
    point_version: Longs  # (q,) number of the cut that made this surface
    point_node: Longs  # (q, POINT_NODES) nodes that it lies between
    point_weight: Floats  # (q, POINT_NODES) of these; 0 for those that fill the row


_PAIR = np.dtype([("organ", "i8", 2), ("node", "i8", 4), ("weight", "f8", 3)])
_POINT = np.dtype(
    [("organ", "i8"), ("number", "i8"), ("version", "i8"), ("node", "i8", POINT_NODES), ("weight", "f8", POINT_NODES)]
)
PAIR_WORDS, POINT_WORDS = _PAIR.itemsize // 8, _POINT.itemsize // 8
POINTS_AT = 1 + MAX_PAIRS * PAIR_WORDS  # place of the number of cut points, which these follow


def organ_contact_set(words: Longs | None = None) -> OrganContactSet:
    """Return an empty set of pairs, or a view of another set's words.

    Parameters
    ----------
    words : Longs | None, optional
        Words of another set; None for memory of its own.
    """
    if words is None:
        words = np.zeros(POINTS_AT + 1 + MAX_CUT_POINTS * POINT_WORDS, dtype=np.int64)
    rows, points = words[1:POINTS_AT].view(_PAIR), words[POINTS_AT + 1 :].view(_POINT)
    of_pairs = words[:1], rows["organ"], rows["node"], rows["weight"]
    of_points = (points[name] for name in ("organ", "number", "version", "node", "weight"))
    return OrganContactSet(words, *of_pairs, words[POINTS_AT : POINTS_AT + 1], *of_points)


def used_words(found: OrganContactSet) -> Longs:
    """Return the words of a set that are in use: its pairs, and its cut points, if any, with their number.

    Parameters
    ----------
    found : OrganContactSet
        The set.
    """
    pairs, points = found.words[: 1 + int(found.found[0]) * PAIR_WORDS], int(found.points[0])
    if points == 0:
        return pairs
    return np.concatenate([pairs, found.words[POINTS_AT : POINTS_AT + 1 + points * POINT_WORDS]])


def set_of_words(words: Longs) -> OrganContactSet:
    """Return the set of which `used_words` returned the words.

    Parameters
    ----------
    words : Longs
        The words.

    Raises
    ------
    ValueError
        When their number differs from the one that they state.
    """
    made = organ_contact_set()
    if words.ndim != 1 or words.dtype != np.int64 or not 1 <= len(words) <= len(made.words):
        raise ValueError("its organ contacts are not whole words")
    count = int(words[0])
    most = 1 + count * PAIR_WORDS
    if not 0 <= count <= MAX_PAIRS or len(words) < most:
        raise ValueError(f"it counts {count} organ contacts, but contains another number")
    points = words[most:]
    if len(points) and not (0 <= points[0] <= MAX_CUT_POINTS and len(points) == 1 + int(points[0]) * POINT_WORDS):
        raise ValueError(f"it counts {count} organ contacts, but contains another number, or other points of cuts")
    made.words[:most] = words[:most]
    made.words[POINTS_AT : POINTS_AT + len(points)] = points
    return made


class ContactPlane(Record):
    """Plane of a pair's triangle."""

    normal: Vector  # outward
    gap: float  # m, distance of the pair's node outside


class OrganContacts(NamedTuple):
    """Pairs of an OrganContactSet, with their forces."""

    found: Longs  # (1,)
    organ: Longs  # (p, 2)
    node: Longs  # (p, 4)
    weight: Floats  # (p, 3)
    points: Longs  # (1,)
    point_organ: Longs  # (q,)
    point_number: Longs  # (q,)
    point_version: Longs  # (q,)
    point_node: Longs  # (q, POINT_NODES)
    point_weight: Floats  # (q, POINT_NODES)
    bearing: Longs  # (p, 2) how many nodes of the first organ bear its force, and how many of both
    bearer: Longs  # (p, MAX_BEARERS) these nodes, those of the first organ first
    part: Floats  # (p, MAX_BEARERS) of the force that each bears
    version: Longs  # (MAX_ORGANS,) number of the newest cut of each organ, or of its reset
    pressed: Floats  # (p,) N along the triangle's normal, in the last substep
    held: Floats  # (p, 3) N across it
    loaded: Floats  # (p, 3) N of the pair in this tick's loads on the node
    friction: Floats  # (1,) Coulomb coefficient
    before: Longs  # (p,) buffer: index in the previous set, or -1
    pressed_before: Floats  # (p,) buffer
    held_before: Floats  # (p, 3) buffer
    plane: ContactPlane  # of the pair that was measured last
    corner: Floats  # (3, 3) m, of that pair's triangle
    caught: Longs  # (MAX_ORGANS,) buffer: 1 for an organ released in this tick


def make_organ_contacts(friction: float = 0.0) -> OrganContacts:
    """Return an empty set of pairs with forces.

    Parameters
    ----------
    friction : float, optional
        Coulomb coefficient.
    """
    return OrganContacts(
        found=np.zeros(1, dtype=np.int64),
        organ=np.zeros((MAX_PAIRS, 2), dtype=np.int64),
        node=np.zeros((MAX_PAIRS, 4), dtype=np.int64),
        weight=np.zeros((MAX_PAIRS, 3)),
        points=np.zeros(1, dtype=np.int64),
        point_organ=np.zeros(MAX_CUT_POINTS, dtype=np.int64),
        point_number=np.zeros(MAX_CUT_POINTS, dtype=np.int64),
        point_version=np.zeros(MAX_CUT_POINTS, dtype=np.int64),
        point_node=np.zeros((MAX_CUT_POINTS, POINT_NODES), dtype=np.int64),
        point_weight=np.zeros((MAX_CUT_POINTS, POINT_NODES)),
        bearing=np.zeros((MAX_PAIRS, 2), dtype=np.int64),
        bearer=np.zeros((MAX_PAIRS, MAX_BEARERS), dtype=np.int64),
        part=np.zeros((MAX_PAIRS, MAX_BEARERS)),
        version=np.zeros(MAX_ORGANS, dtype=np.int64),
        pressed=np.zeros(MAX_PAIRS),
        held=np.zeros((MAX_PAIRS, 3)),
        loaded=np.zeros((MAX_PAIRS, 3)),
        friction=np.array([friction]),
        before=np.zeros(MAX_PAIRS, dtype=np.int64),
        pressed_before=np.zeros(MAX_PAIRS),
        held_before=np.zeros((MAX_PAIRS, 3)),
        plane=ContactPlane.new(),
        corner=np.zeros((3, 3)),
        caught=np.zeros(MAX_ORGANS, dtype=np.int64),
    )


@kernel
def separate_points(found: OrganContactSet) -> None:
    """Move the cut points of a set to their own place, if they follow the pairs directly, as in a mailbox.

    Parameters
    ----------
    found : OrganContactSet
        The set; updated.
    """
    words, start = found.words, 1 + found.found[0] * PAIR_WORDS
    for index in range(words[start] * POINT_WORDS, -1, -1):  # from the end, as both places may overlap
        words[POINTS_AT + index] = words[start + index]


@kernel
def take_pairs(pairs: OrganContacts, found: OrganContactSet) -> None:
    """Apply an OrganContactSet; pairs that existed before keep their forces.

    Parameters
    ----------
    pairs : OrganContacts
        The pairs; updated.
    found : OrganContactSet
        The new set; pairs on a surface that an organ no longer has are left out of it.
    """
    drop_outdated(found, pairs.version)
    count, old_count, old = found.found[0], pairs.found[0], 0
    copy(pairs.pressed[:old_count], pairs.pressed_before[:old_count])
    copy(pairs.held[:old_count], pairs.held_before[:old_count])
    for pair in range(count):
        while old < old_count and comes_before(pairs, old, found, pair):
            old += 1
        same = old < old_count and not comes_before(found, pair, pairs, old)
        pairs.before[pair] = old if same else -1
    pairs.found[0] = count
    copy_points(found, pairs)
    for pair in range(count):
        before = pairs.before[pair]
        pairs.pressed[pair] = pairs.pressed_before[before] if before >= 0 else 0.0
        for axis in range(3):
            pairs.held[pair, axis] = pairs.held_before[before, axis] if before >= 0 else 0.0
        copy_pair(found, pair, pairs, pair)
        note_bearers(pairs, pair)


@kernel
def copy_pair(
    source: OrganContacts | OrganContactSet, pair: int, target: OrganContacts | OrganContactSet, place: int
) -> None:
    """Copy a pair of one set, without its force, to a place in another.

    Parameters
    ----------
    source : OrganContacts | OrganContactSet
        The pair's set.
    pair : int
        Its index there.
    target : OrganContacts | OrganContactSet
        The other set; updated.
    place : int
        Index there.
    """
    for axis in range(3):
        target.weight[place, axis] = source.weight[pair, axis]
    for end in range(2):
        target.organ[place, end] = source.organ[pair, end]
    for corner in range(4):
        target.node[place, corner] = source.node[pair, corner]


@kernel
def copy_points(source: OrganContacts | OrganContactSet, target: OrganContacts | OrganContactSet) -> None:
    """Copy all cut points of a set to another.

    Parameters
    ----------
    source : OrganContacts | OrganContactSet
        The set.
    target : OrganContacts | OrganContactSet
        The other one; updated.
    """
    target.points[0] = source.points[0]
    for point in range(source.points[0]):
        target.point_organ[point] = source.point_organ[point]
        target.point_number[point] = source.point_number[point]
        target.point_version[point] = source.point_version[point]
        for k in range(POINT_NODES):
            target.point_node[point, k] = source.point_node[point, k]
            target.point_weight[point, k] = source.point_weight[point, k]


@kernel
def comes_before(
    first: OrganContacts | OrganContactSet, pair: int, second: OrganContacts | OrganContactSet, other: int
) -> bool:
    """Return whether a pair of one set is ordered before one of another, by organs and node."""
    a, b = first.organ[pair], second.organ[other]
    if a[0] != b[0]:
        return a[0] < b[0]
    if a[1] != b[1]:
        return a[1] < b[1]
    return number_of_node(first, pair) < number_of_node(second, other)


@kernel
def number_of_node(found: OrganContacts | OrganContactSet, pair: int) -> int:
    """Return the number of a pair's node in the surface: cut points come after the nodes."""
    node = found.node[pair, 0]
    return node if node >= 0 else found.point_number[-1 - node]


@kernel
def is_outdated(found: OrganContacts | OrganContactSet, pair: int, version: Longs) -> bool:
    """Return whether a pair has a cut point of a surface that its organ no longer has; version: see OrganContacts."""
    outdated = False
    for corner in range(4):
        point = -1 - found.node[pair, corner]
        if point >= 0:
            outdated = outdated or found.point_version[point] != version[found.point_organ[point]]
    return outdated


@kernel
def drop_outdated(found: OrganContactSet, version: Longs) -> None:
    """Leave out the pairs of a set that are outdated."""
    if found.points[0] == 0:
        return
    kept = 0
    for pair in range(found.found[0]):
        if not is_outdated(found, pair, version):
            copy_pair(found, pair, found, kept)
            kept += 1
    found.found[0] = kept


@kernel
def renew_surface(pairs: OrganContacts, organ: int, version: int) -> None:
    """Set the version of an organ's surface, and drop pairs with points of the previous one.

    Parameters
    ----------
    pairs : OrganContacts
        The pairs; updated.
    organ : int
        Index of the organ.
    version : int
        Number of the cut that made the surface.
    """
    if pairs.version[organ] == version:
        return
    pairs.version[organ] = version
    kept = 0
    for pair in range(pairs.found[0]):
        if is_outdated(pairs, pair, pairs.version):
            continue
        if kept < pair:
            copy_pair(pairs, pair, pairs, kept)
            pairs.pressed[kept] = pairs.pressed[pair]
            copy(pairs.held[pair], pairs.held[kept])
            copy(pairs.loaded[pair], pairs.loaded[kept])
            note_bearers(pairs, kept)
        kept += 1
    pairs.found[0] = kept


@kernel
def note_bearers(pairs: OrganContacts, pair: int) -> None:
    """List the nodes that bear the force of a pair: those of its points, each once."""
    node, weight = pairs.node[pair], pairs.weight[pair]
    own = add_bearers(pairs, pair, node[0], 1.0, 0, 0)
    every, lies_between = own, min(node[1], node[2], node[3]) < 0
    for corner in range(3):
        # In a triangle of a cut, a corner without weight would take the place of one that bears force.
        if weight[corner] != 0.0 or not lies_between:
            every = add_bearers(pairs, pair, node[1 + corner], weight[corner], own, every)
    pairs.bearing[pair, 0], pairs.bearing[pair, 1] = own, every


@kernel
def add_bearers(pairs: OrganContacts, pair: int, node: int, weight: float, start: int, count: int) -> int:
    """Add a node, or those of a cut point, to the bearers of a pair from `start` on; return the new count."""
    if node >= 0:
        return add_bearer(pairs, pair, node, weight, start, count)
    point = -1 - node
    for k in range(POINT_NODES):
        part = weight * pairs.point_weight[point, k]
        if part != 0.0:
            count = add_bearer(pairs, pair, pairs.point_node[point, k], part, start, count)
    return count


@kernel
def add_bearer(pairs: OrganContacts, pair: int, node: int, part: float, start: int, count: int) -> int:
    """Add a node to the bearers of a pair from `start` on, or its part to that of the same node."""
    for k in range(start, count):
        if pairs.bearer[pair, k] == node:
            pairs.part[pair, k] += part
            return count
    if count < start + POINT_NODES:
        pairs.bearer[pair, count], pairs.part[pair, count] = node, part
        count += 1
    return count
