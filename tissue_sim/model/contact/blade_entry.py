"""Entry of blades into tissue: where the load on their edges reaches its resistance, and beside places inside."""

from __future__ import annotations

import math

from tissue_sim.jit import kernel
from tissue_sim.model.contact.active_contact import ActiveContact
from tissue_sim.model.contact.blade_places import (
    is_known,
    leave_tissue,
    locate,
    place_in,
    put_into,
    times,
    turned_by,
    write_back,
    write_offset,
)
from tissue_sim.model.data.blades import CORNERS, Blades
from tissue_sim.model.data.contact_set import nodes_of
from tissue_sim.model.data.state import State
from tissue_sim.model.data.world import World

MOST_OFFSET = 1e-3  # m, largest offset of a place from the tissue around it when it enters beside others
SMOOTH = 5e-3  # s over which the load on an edge is averaged before it enters


@kernel
def enters(world: World, number: int) -> bool:
    """Return whether a place of a blade is now in tissue, by the nearest place of its body that is already inside.

    Parameters
    ----------
    world : World
        Model, state, shapes and working memory; the place is updated.
    number : int
        Index of the place.
    """
    state, scratch, cells, blades = world.state, world.scratch, world.model.cut_cells, world.shapes.blades
    best, chosen, body = math.inf, -1, blades.body[number]
    for other in range(len(state.blades)):
        if blades.body[other] == body and state.blades[other].embedded:
            square = 0.0
            for axis in range(3):
                square += (blades.at[other, axis] - blades.at[number, axis]) ** 2
            if square < best:
                best, chosen = square, other
    if chosen < 0:
        return False
    beside, sample, at, weight = state.blades[chosen], state.blades[number], scratch.blade_at, scratch.blade_weight
    if not locate(cells, beside, weight):
        return False
    cell = beside.cell
    turned_by(scratch.rotation[body], blades.at[number], at)
    for axis in range(3):
        at[axis] += scratch.origin[body, axis] - place_in(cells, cell, state.position, weight, axis)
    write_back(cells, cell, state.position, scratch, scratch.blade_back)
    if not is_known(scratch.blade_back):
        return False
    x, y, z = times(scratch.blade_back, at[0], at[1], at[2])
    leave_tissue(sample)
    sample.rest[0], sample.rest[1], sample.rest[2] = beside.rest[0] + x, beside.rest[1] + y, beside.rest[2] + z
    sample.cell = cell
    if not locate(cells, sample, weight):
        return False
    for corner in range(CORNERS):
        if weight[corner] < 0.0:
            return False
    write_offset(world, number, weight)
    square = 0.0
    for axis in range(3):
        square += sample.offset[axis] ** 2
    if square > MOST_OFFSET * MOST_OFFSET:
        return False
    sample.embedded = True
    sample.free = cells.is_cut[sample.cell] == 1
    return True


@kernel
def begin_cuts(world: World, touching: int, step: float) -> None:
    """Let blades enter tissue if the load on their edges reaches its resistance.

    Parameters
    ----------
    world : World
        Model, state, shapes, settings and working memory; updated.
    touching : int
        Number of the contact points in scratch.active.
    step : float, s
        The substep.
    """
    state, blades, cells = world.state, world.shapes.blades, world.model.cut_cells
    if len(state.blades) == 0 or len(cells.nodes) == 0:
        return
    for body in range(len(state.bodies)):
        if state.bodies[body].cutting or not state.bodies[body].engaged:
            continue
        load, touched, width = _edge_load(world, body, touching)
        if touched == 0.0 or load <= 0.0:
            forget_load(state, blades, body)
            continue
        if not _is_heavy(world, body, load / step, width, step):
            continue
        began = False
        for number in range(len(state.blades)):
            if blades.body[number] == body and blades.width[number] > 0.0:
                began = _begin(world, number, touching) or began
        if began:
            forget_load(state, blades, body)
            state.bodies[body].cutting = True
            for entry in range(state.contacts.header.points):
                if state.contacts.body[entry] == body:
                    state.contact_pressed[0, entry] = 0.0
                    state.contact_held[0, entry] = 0.0


@kernel
def forget_load(state: State, blades: Blades, body: int) -> None:
    """Reset the load on the edge of a body that presses nothing.

    Parameters
    ----------
    state : State
        State of the simulation; updated.
    blades : Blades
        Places of all blades.
    body : int
        The body.
    """
    for number in range(len(state.blades)):
        if blades.body[number] == body:
            state.blades[number].load = 0.0


@kernel
def _is_heavy(world: World, body: int, load: float, width: float, step: float) -> bool:
    """Return whether a load, N, on a width, m, of an edge has reached the resistance of the tissue for some time."""
    state, blades = world.state, world.shapes.blades
    for number in range(len(state.blades)):
        if blades.body[number] == body:
            sample = state.blades[number]
            sample.load += min(1.0, step / SMOOTH) * (load - sample.load)
            return sample.load >= world.settings.toughness * width
    return False


@kernel
def _edge_load(world: World, body: int, touching: int) -> tuple[float, float, float]:
    """Return the forward impulse, N s, by which the edge of a body presses, and two widths, m, of the edge.

    The first width is that of the part that presses anything, the second that of the part that presses tissue to be
    cut, or 0 for a blade that cuts it without force.
    """
    state, blades, scratch = world.state, world.shapes.blades, world.scratch
    load = touched = width = 0.0
    is_first = True
    for number in range(len(state.blades)):
        if blades.body[number] != body or blades.width[number] == 0.0:
            continue
        if is_first:
            turned_by(scratch.rotation[body], blades.forward[number], scratch.blade_way)
            is_first = False
        chosen = _pressed_beside(world, number, touching)
        if chosen >= 0:
            touched += blades.width[number]
            if blades.speed[number] == 0.0 and not _is_in_cut(world, scratch.active[chosen]):
                width += blades.width[number]
    forward = scratch.blade_way
    for index in range(touching):
        contact = scratch.active[index]
        if contact.body == body and contact.pressed > 0.0:
            for axis in range(3):
                load += forward[axis] * (contact.pressed * contact.normal[axis] + contact.held[axis])
    return load, touched, width


@kernel
def _is_in_cut(world: World, contact: ActiveContact) -> bool:
    """Return whether a contact point lies on the lips of a cut, or on its walls."""
    cells, count = world.model.cut_cells, len(world.model.cut_cells.first)
    for corner in range(contact.nodes):
        if contact.node[corner] >= count:
            return True
    return cells.is_cut[cells.first[contact.node[0]]] == 1


@kernel
def _pressed_beside(world: World, number: int, touching: int) -> int:
    """Return the active contact that presses nearest to a place of an edge.

    It is -1 if the edge presses on one side of that place only, or nowhere: contact points may be farther apart than
    the places are.
    """
    blades, scratch = world.shapes.blades, world.scratch
    body, at = blades.body[number], scratch.blade_at
    turned_by(scratch.rotation[body], blades.at[number], at)
    f, n, local, along = blades.forward[number], blades.normal[number], scratch.blade_back, scratch.blade_weight
    local[0], local[1], local[2] = n[1] * f[2] - n[2] * f[1], n[2] * f[0] - n[0] * f[2], n[0] * f[1] - n[1] * f[0]
    turned_by(scratch.rotation[body], local, along)
    best, chosen, half = math.inf, -1, 0.5 * blades.width[number]
    before = behind = False
    for index in range(touching):
        contact = scratch.active[index]
        if contact.body != body or contact.pressed <= 0.0:
            continue
        square = beside = 0.0
        for axis in range(3):
            square += (contact.arm[axis] - at[axis]) ** 2
            beside += along[axis] * (contact.arm[axis] - at[axis])
        before, behind = before or beside < half, behind or beside > -half
        if square < best:
            best, chosen = square, index
    return chosen if before and behind else -1


@kernel
def _begin(world: World, number: int, touching: int) -> bool:
    """Put a place of an edge into the tissue that it presses; return whether it presses any."""
    state, scratch, cells = world.state, world.scratch, world.model.cut_cells
    chosen = _pressed_beside(world, number, touching)
    if chosen < 0:
        return False
    contact, sample, at = scratch.active[chosen], state.blades[number], scratch.blade_at
    node = contact.node[0]
    for corner in range(contact.nodes):
        if contact.node[corner] < len(cells.first):
            node = contact.node[corner]
    if node >= len(cells.first):
        return False  # between virtual nodes alone, which don't determine a cell
    leave_tissue(sample)
    rest = world.model.rest
    for axis in range(3):
        place = 0.0
        for corner in range(nodes_of(state.contacts, contact.entry)):
            place += contact.weight[corner] * rest[contact.node[corner], axis]
        sample.rest[axis] = place + at[axis] - contact.arm[axis]
    sample.cell = cells.first[node]
    if not locate(cells, sample, scratch.blade_weight):
        put_into(cells, sample, scratch.blade_weight, rest)
        locate(cells, sample, scratch.blade_weight)
    sample.embedded = True
    sample.free = cells.is_cut[sample.cell] == 1
    write_offset(world, number, scratch.blade_weight)
    return True
