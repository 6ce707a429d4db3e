"""Contact between organs: surface nodes of one on triangles of another, with friction.

As between tissue and tools, there is no penetration, and no sliding within the friction cone, by projected Gauss-Seidel
on forces that are kept from one substep to the next. The opposite of the force on a node acts on the triangle's three
nodes; at a cut, where points lie between nodes, it acts on those nodes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from tissue_sim.array_types import Floats, Longs
from tissue_sim.jit import kernel
from tissue_sim.model.data.contact_set import POINT_NODES
from tissue_sim.model.data.state import State
from tissue_sim.model.data.world import World
from tissue_sim.model.stepping.breathing import Carried
from tissue_sim.model.stepping.contact_pairs import OrganContacts
from tissue_sim.model.stepping.inputs import load_node

SWEEPS = 8  # over all pairs in a substep
RECOVERY_SPEED = 0.2  # m/s, largest speed at which a node that was inside is moved out
TOLERANCE = 1e-3  # of the sum of all forces: change in a sweep at which it has converged
INTERLOCKED_DEPTH = 1e-3  # m inside, far beyond contact, at which organs count as interlocked


@kernel
def wake_touched_organs(worlds: Sequence[World], pairs: OrganContacts, awake: Longs) -> None:
    """Load the forces of pairs, so that the next tick advances organs that others touch, if they may be awake.

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
            load_bearers(worlds, pairs, pair)


@kernel
def move_alike(state: State, other: State) -> bool:
    """Return whether the breath has not moved two organs relative to each other."""
    a, b = state.carried, other.carried
    return a[0] == b[0] and a[1] == b[1] and a[2] == b[2]


@kernel
def note_interlocked(worlds: Sequence[World], pairs: OrganContacts) -> None:
    """Find organs that lie deep inside each other after a fault, and have not been at rest since.

    They were driven through each other, and contact forces can't separate them: without these, each returns to its own
    shape.
    """
    pairs.caught[:] = 0
    for pair in range(pairs.found[0]):
        first, second = pairs.organ[pair, 0], pairs.organ[pair, 1]
        if worlds[first].state.status.faulted or worlds[second].state.status.faulted:
            measure(worlds, pairs, pair)
            if pairs.plane.gap < -INTERLOCKED_DEPTH:
                pairs.caught[first] = pairs.caught[second] = 1


@kernel
def is_released(pairs: OrganContacts, pair: int) -> bool:
    """Return whether one of a pair's organs is interlocked: it presses on no other organ until they are separate."""
    return pairs.caught[pairs.organ[pair, 0]] == 1 or pairs.caught[pairs.organ[pair, 1]] == 1


@kernel
def apply_organ_contacts(worlds: Sequence[World], pairs: OrganContacts, awake: Longs) -> None:
    """Apply the force of every pair as it was at the end of the last substep.

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
            load_bearers(worlds, pairs, pair)


@kernel
def load_bearers(worlds: Sequence[World], pairs: OrganContacts, pair: int) -> None:
    """Set the loads of a pair's nodes to its force; pairs.plane has been computed."""
    normal, held, loaded, pressed = pairs.plane.normal, pairs.held[pair], pairs.loaded[pair], pairs.pressed[pair]
    x = pressed * normal[0] + held[0] - loaded[0]
    y = pressed * normal[1] + held[1] - loaded[1]
    z = pressed * normal[2] + held[2] - loaded[2]
    loaded[0] += x
    loaded[1] += y
    loaded[2] += z
    own, every = pairs.bearing[pair, 0], pairs.bearing[pair, 1]
    for k in range(every):
        part = pairs.part[pair, k] if k < own else -pairs.part[pair, k]
        state = worlds[pairs.organ[pair, 0 if k < own else 1]].state
        load_node(state, pairs.bearer[pair, k], part * x, part * y, part * z)


@kernel
def resolve_organ_contacts(
    worlds: Sequence[World], carried: Carried, pairs: OrganContacts, awake: Longs, step: float
) -> None:
    """Move every node out of its triangle at the end of a substep.

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
    normal, bearer, part = pairs.plane.normal, pairs.bearer[pair], pairs.part[pair]
    place_corners(under.position, pairs, node)
    a, b, c = pairs.corner[0], pairs.corner[1], pairs.corner[2]
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    size = math.sqrt(x * x + y * y + z * z)
    inverse = 1.0 / size if size > 0.0 else 0.0
    normal[0], normal[1], normal[2] = x * inverse, y * inverse, z * inverse
    gap = 0.0
    for axis in range(3):
        on = part[0] * own.position[bearer[0], axis]
        for k in range(1, pairs.bearing[pair, 0]):
            on += part[k] * own.position[bearer[k], axis]
        on = on + own.carried[axis] - under.carried[axis]
        gap += normal[axis] * (on - a[axis])
    pairs.plane.gap = gap


@kernel
def place_corners(position: Floats, pairs: OrganContacts, node: Longs) -> None:
    """Write where the corners of a pair's triangle are, node[1] to node[3], to pairs.corner."""
    for corner in range(3):
        place, one = pairs.corner[corner], node[1 + corner]
        point = -1 - one
        for axis in range(3):
            at = 0.0
            if one >= 0:
                at = position[one, axis]
            else:
                for k in range(POINT_NODES):
                    at += pairs.point_weight[point, k] * position[pairs.point_node[point, k], axis]
            place[axis] = at


@kernel
def resolve_organ_contact(
    worlds: Sequence[World], carried: Carried, pairs: OrganContacts, pair: int, step: float
) -> float:
    """Resolve one pair; return the change of its force, N."""
    first, second = pairs.organ[pair, 0], pairs.organ[pair, 1]
    bearer, part, held = pairs.bearer[pair], pairs.part[pair], pairs.held[pair]
    n_own, every = pairs.bearing[pair, 0], pairs.bearing[pair, 1]
    measure(worlds, pairs, pair)
    pressed, gap, normal = pairs.pressed[pair], pairs.plane.gap, pairs.plane.normal
    if gap > 0.0 and pressed == 0.0:
        return 0.0
    own, other = worlds[first], worlds[second]
    # Each organ moves as if the force had acted during the whole of its own substep, which may be a coarse one.
    own_step, other_step = substep_of(own), substep_of(other)
    light = 0.0
    for k in range(n_own):
        light += part[k] ** 2 * own_step * own_step * own.scratch.mobility[bearer[k]]
    for k in range(n_own, every):
        light += part[k] ** 2 * other_step * other_step * other.scratch.mobility[bearer[k]]
    if light == 0.0:
        return 0.0
    stiffness = 1.0 / light  # N/m, force that moves the node a metre out of the triangle
    push = max(0.0, pressed - max(gap, -RECOVERY_SPEED * step) * stiffness)
    sx, sy, sz = sliding_motion(worlds, carried, pairs, pair, step)
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
    for k in range(n_own):
        move(own, bearer[k], part[k] * px, part[k] * py, part[k] * pz, own_step)
    for k in range(n_own, every):
        move(other, bearer[k], -part[k] * px, -part[k] * py, -part[k] * pz, other_step)
    return math.sqrt(px * px + py * py + pz * pz)


@kernel
def substep_of(world: World) -> float:
    """Return the substep of an organ in this tick, s."""
    step: float = world.settings.tick_time / world.scratch.plan.substeps
    return step


@kernel
def sliding_motion(
    worlds: Sequence[World], carried: Carried, pairs: OrganContacts, pair: int, step: float
) -> tuple[float, float, float]:
    """Return the tangential motion of the node relative to the triangle in a substep, m."""
    first, second = pairs.organ[pair, 0], pairs.organ[pair, 1]
    bearer, part, own = pairs.bearer[pair], pairs.part[pair], pairs.bearing[pair, 0]
    moved, under = worlds[first].state.velocity, worlds[second].state.velocity
    a, b = carried.speed[first], carried.speed[second]
    x, y, z = part[0] * moved[bearer[0], 0], part[0] * moved[bearer[0], 1], part[0] * moved[bearer[0], 2]
    for k in range(1, own):
        velocity = moved[bearer[k]]
        x += part[k] * velocity[0]
        y += part[k] * velocity[1]
        z += part[k] * velocity[2]
    x, y, z = x + a[0] - b[0], y + a[1] - b[1], z + a[2] - b[2]
    for k in range(own, pairs.bearing[pair, 1]):
        velocity = under[bearer[k]]
        x -= part[k] * velocity[0]
        y -= part[k] * velocity[1]
        z -= part[k] * velocity[2]
    return step * x, step * y, step * z


@kernel
def move(world: World, node: int, x: float, y: float, z: float, step: float) -> None:
    """Move a node as if the force x, y, z, N, had acted on it during the whole last substep."""
    faster = step * world.scratch.mobility[node]
    position, velocity = world.state.position[node], world.state.velocity[node]
    velocity[0] += faster * x
    velocity[1] += faster * y
    velocity[2] += faster * z
    position[0] += step * faster * x
    position[1] += step * faster * y
    position[2] += step * faster * z
