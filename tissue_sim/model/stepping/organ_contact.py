"""Contact between organs: surface nodes of one on triangles of another, with friction.

As between tissue and tools: no penetration, and no sliding within the friction cone, by projected Gauss-Seidel on
forces that are kept from one substep to the next. The force on a node acts on the triangle's three nodes, reversed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tissue_sim.array_types import Floats, Longs
from tissue_sim.jit import kernel
from tissue_sim.model.data.arrays import copy
from tissue_sim.model.data.records import Record, Vector
from tissue_sim.model.data.state import State
from tissue_sim.model.data.world import World
from tissue_sim.model.stepping.breathing import Carried
from tissue_sim.model.stepping.inputs import load_node

MOST_PAIRS = 4096
SWEEPS = 8  # over all pairs in a substep
RECOVERY_SPEED = 0.2  # m/s, largest speed at which what lay inside comes out
TOLERANCE = 1e-3  # of the sum of all forces: change in a sweep at which it has converged
MOST_ORGANS = 16
CAUGHT = 1e-3  # m inside, far beyond contact, at which organs count as caught in each other


class OrganContactSet(NamedTuple):
    """Room for MOST_PAIRS pairs, a node of organ[0] and a triangle of organ[1], in the order of organs and nodes."""

    words: Longs  # memory of the others
    found: Longs  # (1,) number of pairs
    organ: Longs  # (p, 2)
    node: Longs  # (p, 4) the node, and the triangle's three
    weight: Floats  # (p, 3) barycentric, of the place on the triangle that is nearest to the node


_PAIR = np.dtype([("organ", "i8", 2), ("node", "i8", 4), ("weight", "f8", 3)])


def organ_contact_set(words: Longs | None = None) -> OrganContactSet:
    """Return an empty set of pairs, or a view of another set's words.

    Parameters
    ----------
    words : Longs | None, optional
        Words of another set; None for memory of its own.

    Returns
    -------
    OrganContactSet
        The set.
    """
    if words is None:
        words = np.zeros(1 + MOST_PAIRS * _PAIR.itemsize // 8, dtype=np.int64)
    rows = words[1:].view(_PAIR)
    return OrganContactSet(words, words[:1], rows["organ"], rows["node"], rows["weight"])


def used_words(found: OrganContactSet) -> Longs:
    """Return the words of a set that are in use.

    Parameters
    ----------
    found : OrganContactSet
        The set.

    Returns
    -------
    Longs
        The words.
    """
    return found.words[: 1 + int(found.found[0]) * _PAIR.itemsize // 8]


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
    pressed: Floats  # (p,) N along the triangle's normal, in the last substep
    held: Floats  # (p, 3) N across it
    loaded: Floats  # (p, 3) N that the node bears in this tick's loads
    friction: Floats  # (1,) Coulomb coefficient
    before: Longs  # (p,) buffer: index in the previous set, or -1
    pressed_before: Floats  # (p,) room
    held_before: Floats  # (p, 3) room
    plane: ContactPlane  # of the pair that was measured last
    caught: Longs  # (MOST_ORGANS,) buffer: 1 for an organ released in this tick


def make_organ_contacts(friction: float = 0.0) -> OrganContacts:
    """Return an empty set of pairs with forces.

    Parameters
    ----------
    friction : float, optional
        Coulomb coefficient.

    Returns
    -------
    Pairs
        The pairs.
    """
    return OrganContacts(
        found=np.zeros(1, dtype=np.int64),
        organ=np.zeros((MOST_PAIRS, 2), dtype=np.int64),
        node=np.zeros((MOST_PAIRS, 4), dtype=np.int64),
        weight=np.zeros((MOST_PAIRS, 3)),
        pressed=np.zeros(MOST_PAIRS),
        held=np.zeros((MOST_PAIRS, 3)),
        loaded=np.zeros((MOST_PAIRS, 3)),
        friction=np.array([friction]),
        before=np.zeros(MOST_PAIRS, dtype=np.int64),
        pressed_before=np.zeros(MOST_PAIRS),
        held_before=np.zeros((MOST_PAIRS, 3)),
        plane=ContactPlane.new(),
        caught=np.zeros(MOST_ORGANS, dtype=np.int64),
    )


@kernel
def take_pairs(pairs: OrganContacts, found: OrganContactSet) -> None:
    """Apply a OrganContactSet; pairs that existed before keep their forces.

    Parameters
    ----------
    pairs : OrganContacts
        The pairs; updated.
    found : OrganContactSet
        The new set.
    """
    count, old_count, old = found.found[0], pairs.found[0], 0
    copy(pairs.pressed[:old_count], pairs.pressed_before[:old_count])
    copy(pairs.held[:old_count], pairs.held_before[:old_count])
    for pair in range(count):
        while old < old_count and comes_before(pairs, old, found, pair):
            old += 1
        same = old < old_count and not comes_before(found, pair, pairs, old)
        pairs.before[pair] = old if same else -1
    pairs.found[0] = count
    for pair in range(count):
        before = pairs.before[pair]
        pairs.pressed[pair] = pairs.pressed_before[before] if before >= 0 else 0.0
        for axis in range(3):
            pairs.held[pair, axis] = pairs.held_before[before, axis] if before >= 0 else 0.0
            pairs.weight[pair, axis] = found.weight[pair, axis]
        for end in range(2):
            pairs.organ[pair, end] = found.organ[pair, end]
        for corner in range(4):
            pairs.node[pair, corner] = found.node[pair, corner]


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
    return first.node[pair, 0] < second.node[other, 0]


@kernel
def wake_touched_organs(worlds: Sequence[World], pairs: OrganContacts, awake: Longs) -> None:
    """Load the forces of pairs, so that the coming tick advances organs that others touch, if they may be awake.

    Parameters
    ----------
    worlds : Sequence[World]
        Worlds of the organs; updated.
    pairs : OrganContacts
        The pairs; updated.
    awake : Longs, shape (k,)
        1 for organs that may be awake.
    """
    note_interlocked(worlds, pairs)
    for pair in range(pairs.found[0]):
        pairs.loaded[pair, 0] = pairs.loaded[pair, 1] = pairs.loaded[pair, 2] = 0.0
        if not is_resolved(pairs, pair, awake):
            pairs.pressed[pair] = 0.0
            pairs.held[pair, 0] = pairs.held[pair, 1] = pairs.held[pair, 2] = 0.0
            continue
        first, second = worlds[pairs.organ[pair, 0]], worlds[pairs.organ[pair, 1]]
        if first.state.status.asleep and second.state.status.asleep and move_alike(first.state, second.state):
            continue
        measure(worlds, pairs, pair)
        if pairs.pressed[pair] > 0.0 or pairs.plane.gap <= 0.0:
            bear(worlds, pairs, pair)


@kernel
def move_alike(state: State, other: State) -> bool:
    """Return whether the breath has not moved two organs relative to each other."""
    a, b = state.carried, other.carried
    return a[0] == b[0] and a[1] == b[1] and a[2] == b[2]


@kernel
def note_interlocked(worlds: Sequence[World], pairs: OrganContacts) -> None:
    """Find organs that lie deep in each other after a fault, and have not been at rest since.

    They were driven through each other, and no force leads out of that: without any, each returns to its own shape.
    """
    pairs.caught[:] = 0
    for pair in range(pairs.found[0]):
        first, second = pairs.organ[pair, 0], pairs.organ[pair, 1]
        if worlds[first].state.status.faulted or worlds[second].state.status.faulted:
            measure(worlds, pairs, pair)
            if pairs.plane.gap < -CAUGHT:
                pairs.caught[first] = pairs.caught[second] = 1


@kernel
def is_released(pairs: OrganContacts, pair: int) -> bool:
    """Return whether one of a pair's organs is caught: it presses on none until it is out."""
    return pairs.caught[pairs.organ[pair, 0]] == 1 or pairs.caught[pairs.organ[pair, 1]] == 1


@kernel
def apply_organ_contacts(worlds: Sequence[World], pairs: OrganContacts, awake: Longs) -> None:
    """Let every pair press as it did at the end of the last substep.

    Parameters
    ----------
    worlds : Sequence[World]
        Worlds of the organs; updated.
    pairs : OrganContacts
        The pairs; updated.
    awake : Longs, shape (k,)
        1 for organs that this tick advances.
    """
    for pair in range(pairs.found[0]):
        loaded = pairs.loaded[pair]
        was = loaded[0] != 0.0 or loaded[1] != 0.0 or loaded[2] != 0.0
        if is_resolved(pairs, pair, awake) and (pairs.pressed[pair] > 0.0 or was):
            measure(worlds, pairs, pair)
            bear(worlds, pairs, pair)


@kernel
def bear(worlds: Sequence[World], pairs: OrganContacts, pair: int) -> None:
    """Set the loads of a pair's nodes to its force; pairs.plane has been computed."""
    normal, held, loaded, pressed = pairs.plane.normal, pairs.held[pair], pairs.loaded[pair], pairs.pressed[pair]
    x = pressed * normal[0] + held[0] - loaded[0]
    y = pressed * normal[1] + held[1] - loaded[1]
    z = pressed * normal[2] + held[2] - loaded[2]
    loaded[0] += x
    loaded[1] += y
    loaded[2] += z
    for corner in range(4):
        part = 1.0 if corner == 0 else -pairs.weight[pair, corner - 1]
        state = worlds[pairs.organ[pair, min(corner, 1)]].state
        load_node(state, pairs.node[pair, corner], part * x, part * y, part * z)


@kernel
def resolve_organ_contacts(
    worlds: Sequence[World], carried: Carried, pairs: OrganContacts, awake: Longs, step: float
) -> None:
    """Keep every node outside its triangle at the end of a substep.

    Parameters
    ----------
    worlds : Sequence[World]
        Worlds of the organs; updated.
    carried : Carried
        How organs follow the breath; updated.
    pairs : OrganContacts
        The pairs; updated.
    awake : Longs, shape (k,)
        1 for organs that this tick advances.
    step : float, s
        Duration of the substep.
    """
    for _ in range(SWEEPS):
        changed = total = 0.0
        for pair in range(pairs.found[0]):
            if is_resolved(pairs, pair, awake):
                changed += resolve_organ_contact(worlds, carried, pairs, pair, step)
                total += pairs.pressed[pair]
        if changed <= TOLERANCE * total:
            return


@kernel
def is_resolved(pairs: OrganContacts, pair: int, awake: Longs) -> bool:
    """Return whether this tick advances both organs of a pair, and neither is released."""
    both = awake[pairs.organ[pair, 0]] == 1 and awake[pairs.organ[pair, 1]] == 1
    return both and not is_released(pairs, pair)


@kernel
def measure(worlds: Sequence[World], pairs: OrganContacts, pair: int) -> None:
    """Write the triangle's outward normal and the node's distance outside, m, to pairs.plane."""
    first, second = pairs.organ[pair, 0], pairs.organ[pair, 1]
    own, under, node = worlds[first].state, worlds[second].state, pairs.node[pair]
    position, normal = under.position, pairs.plane.normal
    a, b, c = position[node[1]], position[node[2]], position[node[3]]
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    size = math.sqrt(x * x + y * y + z * z)
    inverse = 1.0 / size if size > 0.0 else 0.0
    normal[0], normal[1], normal[2] = x * inverse, y * inverse, z * inverse
    gap = 0.0
    for axis in range(3):
        on = own.position[node[0], axis] + own.carried[axis] - under.carried[axis]
        gap += normal[axis] * (on - a[axis])
    pairs.plane.gap = gap


@kernel
def resolve_organ_contact(
    worlds: Sequence[World], carried: Carried, pairs: OrganContacts, pair: int, step: float
) -> float:
    """Resolve one pair; return the change of its force, N."""
    first, second = pairs.organ[pair, 0], pairs.organ[pair, 1]
    node, weight, held = pairs.node[pair], pairs.weight[pair], pairs.held[pair]
    measure(worlds, pairs, pair)
    pressed, gap, normal = pairs.pressed[pair], pairs.plane.gap, pairs.plane.normal
    if gap > 0.0 and pressed == 0.0:
        return 0.0
    own, other = worlds[first], worlds[second]
    # Each organ moves as if the force had acted during the whole of its own substep, which may be a coarse one.
    own_step, other_step = substep_of(own), substep_of(other)
    light = own_step * own_step * own.scratch.mobility[node[0]]
    for corner in range(3):
        light += weight[corner] ** 2 * other_step * other_step * other.scratch.mobility[node[1 + corner]]
    if light == 0.0:
        return 0.0
    stiffness = 1.0 / light  # N that move the node a metre out of the triangle
    push = max(0.0, pressed - max(gap, -RECOVERY_SPEED * step) * stiffness)
    sx, sy, sz = sliding(worlds, carried, pairs, pair, step)
    along = sx * normal[0] + sy * normal[1] + sz * normal[2]
    tx = held[0] - (sx - along * normal[0]) * stiffness
    ty = held[1] - (sy - along * normal[1]) * stiffness
    tz = held[2] - (sz - along * normal[2]) * stiffness
    size, most = math.sqrt(tx * tx + ty * ty + tz * tz), pairs.friction[0] * push
    fraction = 1.0 if size <= most else most / size
    px = (push - pressed) * normal[0] + fraction * tx - held[0]
    py = (push - pressed) * normal[1] + fraction * ty - held[1]
    pz = (push - pressed) * normal[2] + fraction * tz - held[2]
    pairs.pressed[pair] = push
    held[0], held[1], held[2] = fraction * tx, fraction * ty, fraction * tz
    move(own, node[0], px, py, pz, own_step)
    for corner in range(3):
        part = -weight[corner]
        move(other, node[1 + corner], part * px, part * py, part * pz, other_step)
    return math.sqrt(px * px + py * py + pz * pz)


@kernel
def substep_of(world: World) -> float:
    """Return the substep of an organ in this tick, s."""
    step: float = world.settings.tick_time / world.scratch.plan.substeps
    return step


@kernel
def sliding(
    worlds: Sequence[World], carried: Carried, pairs: OrganContacts, pair: int, step: float
) -> tuple[float, float, float]:
    """Return the motion of the node along the triangle's place in a substep, m."""
    first, second = pairs.organ[pair, 0], pairs.organ[pair, 1]
    node, weight = pairs.node[pair], pairs.weight[pair]
    moved, under = worlds[first].state.velocity, worlds[second].state.velocity
    a, b = carried.speed[first], carried.speed[second]
    x, y, z = moved[node[0], 0] + a[0] - b[0], moved[node[0], 1] + a[1] - b[1], moved[node[0], 2] + a[2] - b[2]
    for corner in range(3):
        velocity = under[node[1 + corner]]
        x -= weight[corner] * velocity[0]
        y -= weight[corner] * velocity[1]
        z -= weight[corner] * velocity[2]
    return step * x, step * y, step * z


@kernel
def move(world: World, node: int, x: float, y: float, z: float, step: float) -> None:
    """Apply the force x, y, z, N, to a node for the whole of a substep that is over."""
    faster = step * world.scratch.mobility[node]
    position, velocity = world.state.position[node], world.state.velocity[node]
    velocity[0] += faster * x
    velocity[1] += faster * y
    velocity[2] += faster * z
    position[0] += step * faster * x
    position[1] += step * faster * y
    position[2] += step * faster * z
