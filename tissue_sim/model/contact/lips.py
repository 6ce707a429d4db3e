"""Contact of the lips of a cut with each other: a constraint besides those of contact with tools.

Before a cut opens, its walls coincide, so that no distance of surfaces shows which of them is in front of the other.
But every point of one wall has its partner on the other: the two copies of the place where the cut crosses an edge of
cells. Along the mean normal of both walls in their present position, the upper one must not come below the lower one.
The impulses are equal and opposite, without friction, and solved together with those of the tools by projected
Gauss-Seidel. They start from zero in every substep, so that nothing has to be stored and a bag can begin anywhere. They
are bounded: between tools and lips there may be no solution, and impulses that accumulate there throw light nodes.

Partners that have slid apart by more than an edge of cells, or whose walls no longer face each other, don't touch: the
opposite place is no longer known.
"""

from __future__ import annotations

import math

import numpy as np

from tissue_sim.array_types import Floats, Longs
from tissue_sim.jit import kernel
from tissue_sim.model.data.lips import ENDS, Lips
from tissue_sim.model.data.state import State

NEAR = 5e-5  # m: distance within which sides may come to touch while others are resolved
RECOVERY_SPEED = 0.2  # m/s, largest speed at which a point that was inside is moved out
FACING = 0.5  # cosine between both walls' normals, from which they face each other
MAX_SPEED_CHANGE = 2.0  # m/s by which a substep may change the speed at which sides approach
# Fraction of the impulses that a pass may still change. At 0.02 the number of passes varied from substep to substep,
# and with it the error that is left: light nodes oscillated.
SETTLED = 1e-3


@kernel
def find_lips(lips: Lips, state: State, mobility: Floats, step: float) -> int:
    """List the places where lips touch, or nearly do, in lips.contacts; return their number.

    Parameters
    ----------
    lips : Lips
        The lips; updated.
    state : State
        State of the simulation.
    mobility : Floats, shape (n,), 1/kg
        Velocity of each node for a unit impulse.
    step : float, s
        The substep.
    """
    if len(lips.upper) == 0:
        return 0
    lips.counts[0] += 1
    lips.counts[1] = lips.counts[2] = 0
    if not _place_sides(lips, state.position):
        return 0
    for side in range(2):
        _add_normals(lips.place[side], lips.triangles, lips.normal[side])
    found = 0
    for place in range(len(lips.upper)):
        if _take(lips, place, state, mobility, step, found):
            found += 1
    lips.counts[2] = found
    return found


@kernel
def _place_sides(lips: Lips, position: Floats) -> bool:
    """Write the positions of both sides of each place; return whether any of them are within reach of each other."""
    any_near = False
    for place in range(len(lips.upper)):
        upper_nodes, lower_nodes, square = lips.upper[place], lips.lower[place], 0.0
        for axis in range(3):
            upper = lower = 0.0
            for end in range(ENDS):
                upper += lips.weight[place, end] * position[upper_nodes[end], axis]
                lower += lips.weight[place, end] * position[lower_nodes[end], axis]
            lips.place[0, place, axis], lips.place[1, place, axis] = upper, lower
            square += (upper - lower) ** 2
        is_open = upper_nodes[0] != lower_nodes[0] or upper_nodes[1] != lower_nodes[1]
        any_near = any_near or (is_open and square < lips.slide[place] ** 2)
    return any_near


@kernel
def _add_normals(place: Floats, triangles: Longs, normal: Floats) -> None:
    """Write the normals (q, 3) of a wall, m^2, from the lower side to the upper one."""
    normal[:] = 0.0
    for t in range(len(triangles)):
        first, second, third = np.uint64(triangles[t, 0]), np.uint64(triangles[t, 1]), np.uint64(triangles[t, 2])
        a, b, c = place[first], place[second], place[third]
        ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
        vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
        x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        for corner in (first, second, third):
            of_corner = normal[corner]
            of_corner[0] -= x
            of_corner[1] -= y
            of_corner[2] -= z


@kernel
def _write_normal(upper: Floats, lower: Floats, normal: Floats) -> bool:
    """Write the mean of both walls' unit normals, (3,) each, as one; return whether the walls face each other."""
    square = other = agrees = 0.0
    for axis in range(3):
        square += upper[axis] * upper[axis]
        other += lower[axis] * lower[axis]
        agrees += upper[axis] * lower[axis]
    if square == 0.0 or other == 0.0 or agrees < FACING * math.sqrt(square * other):
        return False
    square, other, size = math.sqrt(square), math.sqrt(other), 0.0
    for axis in range(3):
        normal[axis] = upper[axis] / square + lower[axis] / other
        size += normal[axis] * normal[axis]
    for axis in range(3):
        normal[axis] /= math.sqrt(size)
    return True


@kernel
def _take(lips: Lips, place: int, state: State, mobility: Floats, step: float, found: int) -> bool:
    """Return whether a place is to be resolved, and fill the record number `found`."""
    contact = lips.contacts[found]
    square, slide = 0.0, max(lips.slide[place], NEAR)
    for axis in range(3):
        square += (lips.place[0, place, axis] - lips.place[1, place, axis]) ** 2
    if square > 4.0 * slide * slide:  # too far apart in any direction
        return False
    if not _write_normal(lips.normal[0, place], lips.normal[1, place], contact.normal):
        return False
    give = gap = opening = square = 0.0
    for end in range(ENDS):
        upper, lower, weight = lips.upper[place, end], lips.lower[place, end], lips.weight[place, end]
        contact.node[end], contact.node[ENDS + end] = upper, lower
        contact.weight[end], contact.weight[ENDS + end] = weight, -weight
        if upper != lower:
            give += weight * weight * (mobility[upper] + mobility[lower])
    if give == 0.0:
        return False
    for axis in range(3):
        apart = moving = 0.0
        for k in range(2 * ENDS):
            apart += contact.weight[k] * state.position[contact.node[k], axis]
            moving += contact.weight[k] * state.velocity[contact.node[k], axis]
        square += apart * apart
        gap += contact.normal[axis] * apart
        opening += contact.normal[axis] * moving
    if gap > NEAR or square - gap * gap > lips.slide[place] ** 2 or gap < -lips.slide[place]:
        return False
    contact.least = min(0.0, gap + step * (RECOVERY_SPEED - opening))
    contact.stiffness, contact.pressed, contact.most = 1.0 / (step * give), 0.0, MAX_SPEED_CHANGE / give
    return True


@kernel
def press_lips(lips: Lips, state: State, mobility: Floats, found: int, step: float) -> bool:
    """Make one pass over the listed places.

    Parameters
    ----------
    lips : Lips
        The lips; updated.
    state : State
        State of the simulation; updated.
    mobility : Floats, shape (n,), 1/kg
        Velocity of each node for a unit impulse.
    found : int
        Number of the listed places.
    step : float, s
        The substep.
    """
    change = total = 0.0
    lips.counts[1] = 0
    for index in range(found):
        contact = lips.contacts[index]
        normal, gap = contact.normal, 0.0
        for k in range(2 * ENDS):
            position = state.position[np.uint64(contact.node[k])]
            gap += contact.weight[k] * (normal[0] * position[0] + normal[1] * position[1] + normal[2] * position[2])
        pushed = min(contact.most, max(0.0, contact.pressed - (gap - contact.least) * contact.stiffness))
        more = pushed - contact.pressed
        contact.pressed = pushed
        total += pushed
        change += abs(more)
        lips.counts[1] += pushed > 0.0
        if more == 0.0:
            continue
        for k in range(2 * ENDS):
            node = contact.node[k]
            # A node that both sides have in common gets no impulse.
            if node == contact.node[(k + ENDS) % (2 * ENDS)]:
                continue
            move = more * contact.weight[k] * mobility[node]
            for axis in range(3):
                state.velocity[node, axis] += move * normal[axis]
                state.position[node, axis] += step * move * normal[axis]
    return change <= SETTLED * total


def add_lip_impulses(lips: Lips, step: float, force: Floats) -> None:
    """Add the forces of lips on each other in the last substep.

    Parameters
    ----------
    lips : Lips
        The lips.
    step : float, s
        The substep.
    force : Floats, shape (n, 3), N
        Forces on the nodes; updated.
    """
    contacts, count = lips.contacts, lips.counts[2]
    push = (contacts.pressed[:count] / step)[:, None, None] * contacts.normal[:count, None, :]
    np.add.at(force, contacts.node[:count], contacts.weight[:count, :, None] * push)
