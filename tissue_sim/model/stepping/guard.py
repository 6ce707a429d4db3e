"""Guard: keeps the last valid shape, returns to it after a faulty tick, and detects inverted cells."""

from __future__ import annotations

import math

from tissue_sim.array_types import Floats, Ints
from tissue_sim.jit import kernel
from tissue_sim.model.contact.blade_places import forget_blades
from tissue_sim.model.contact.tool_motion import restore_bodies
from tissue_sim.model.data.arrays import copy, copy_nodes
from tissue_sim.model.data.model import Model
from tissue_sim.model.data.scratch import Scratch
from tissue_sim.model.data.settings import Settings
from tissue_sim.model.data.state import Fault, Region, State
from tissue_sim.model.regions.active_region import restore_shape
from tissue_sim.model.regions.mode_motion import modes_are_finite
from tissue_sim.model.regions.moved_nodes import are_placed, checked_nodes
from tissue_sim.model.stepping.inputs import MAX_BACKOFF
from tissue_sim.model.stepping.relaxation import forget_relaxation

RUNAWAY_RATE = 100.0  # 1/s, largest speed over the organ's size of all nodes together
RETURN_RATE = 20.0  # 1/s, rate of the recovery to rest
CELLS_A_TICK = 32  # a rolling check: all 1984 of the kidney's every 62 ticks
PER_AXIS = 1.0 / math.sqrt(3.0)  # a vector with smaller coordinates is shorter than 1
KEEP_EVERY = 4  # ticks between two shapes that are kept
MAX_INVERTED = 0.5  # fraction of the cells; an organ with more inverted cells doesn't recover by itself


@kernel
def guard(model: Model, state: State, settings: Settings, scratch: Scratch) -> None:
    """Keep this shape if it is finite and bounded, otherwise return to the last valid one, without speed.

    Bounded means that no node is farther from rest than the organ's own size, that none moves farther than that in a
    tick, and that all of them together are no faster than a hundred times that per second. After a fault the substeps
    double, up to a factor of 8 and then from 1 again, until the organ has slept or recovered; if that doesn't help, the
    valid shape is moved towards rest a little. An organ of which more than half is inverted is moved in each tick.

    Parameters
    ----------
    model : Model
        Constants of the model.
    state : State
        State of the simulation; updated.
    settings : Settings
        Settings of the simulation.
    scratch : Scratch
        Working memory; updated.
    """
    status, count = state.status, state.count
    span = settings.runaway_span
    speed = span / settings.tick_time
    energy = (RUNAWAY_RATE * span) ** 2
    if status.region == Region.WHOLE:
        size = state.position.size
        x, v, x0 = state.position.reshape(size), state.velocity.reshape(size), model.rest.reshape(size)
        fault = 0
        # Faults are rare, and only then the nodes are checked one by one.
        if not is_bounded(x, v, x0, span * PER_AXIS, min(speed, RUNAWAY_RATE * span) * PER_AXIS):
            fault = check(model, state, model.moving, span * span, speed * speed, energy)
    else:
        fault = check(model, state, checked_nodes(model, state, scratch), span * span, speed * speed, energy)
        if not modes_are_finite(state):
            fault = Fault.NOT_FINITE.value
    collapsing = status.turned > MAX_INVERTED * len(model.cells)
    if collapsing and not status.collapsing:
        count.faults += 1
        status.fault_kind = Fault.COLLAPSED
        status.faulted = True
    status.collapsing = collapsing
    if fault == 0:
        if collapsing:
            move_towards_rest(model, state, settings)
            forget_relaxation(state)
        keep(model, state, scratch)
        return
    restore_shape(model, state, scratch)
    forget_relaxation(state)
    restore_bodies(state, span)
    forget_blades(state)
    state.contact_pressed[:] = 0.0
    state.contact_held[:] = 0.0
    scratch.impulse[:] = 0.0
    count.faults += 1
    status.fault_kind = fault
    status.faulted = True
    again = status.good_age > KEEP_EVERY
    status.good_age = KEEP_EVERY + 1
    if status.backoff < MAX_BACKOFF:
        status.backoff *= 2
        return
    # If the shortest substeps fail as well, the cause is the load, or the shape itself.
    status.backoff = 1
    if again:
        move_towards_rest(model, state, settings)
        copy(state.position, state.good_position)


@kernel
def move_towards_rest(model: Model, state: State, settings: Settings) -> float:
    """Move every node nearer to rest, without speed; pieces that were cut off stay where they are.

    This is the recovery from a shape that the springs hold, so their forces are left out.

    Parameters
    ----------
    model : Model
        Constants of the model.
    state : State
        State of the simulation; updated.
    settings : Settings
        Settings of the simulation.

    Returns
    -------
    float, m
        Largest remaining displacement.
    """
    displacement, left = 0.0, math.exp(-RETURN_RATE * settings.tick_time)
    for index in range(len(model.moving)):
        node = model.moving[index]
        if len(model.free) > 0 and model.free[node] != 0:
            continue
        for c in range(3):
            offset = left * (state.position[node, c] - model.rest[node, c])
            state.position[node, c] = model.rest[node, c] + offset
            state.velocity[node, c] = 0.0
            displacement = max(displacement, abs(offset))
    return displacement


@kernel
def is_bounded(position: Floats, velocity: Floats, rest: Floats, span: float, speed: float) -> bool:
    """Return whether all coordinates are within `span`, m, of rest and slower than `speed`, m/s; flat arrays.

    The bounded ones are counted, since integers may be added in any order, so that the loop is vectorised. Comparisons
    with NaN are false, so NaN is found, too.
    """
    good = 0
    for index in range(len(position)):
        near = abs(position[index] - rest[index]) < span
        slow = abs(velocity[index]) < speed
        good += near & slow
    return good == len(position)


@kernel
def check(model: Model, state: State, nodes: Ints, span: float, speed: float, energy: float) -> int:
    """Return the fault of the nodes, Fault.NOT_FINITE or Fault.RUNAWAY; 0 for none.

    span: squared distance from rest, m^2, speed: squared speed, m^2/s^2, energy: mean squared speed, m^2/s^2, each a
    limit beyond which it is a fault.
    """
    good = True
    moved_sum = sped_sum = 0.0
    position, velocity, rest, has_free = state.position, state.velocity, model.rest, len(model.free) > 0
    for index in range(len(nodes)):
        node = nodes[index]
        x = position[node, 0] - rest[node, 0]
        y = position[node, 1] - rest[node, 1]
        z = position[node, 2] - rest[node, 2]
        u, v, w = velocity[node, 0], velocity[node, 1], velocity[node, 2]
        moved = x * x + y * y + z * z
        sped = u * u + v * v + w * w
        if has_free and math.isfinite(moved) and model.free[node] != 0:
            moved = 0.0  # a piece that was cut off may go anywhere
        # Comparisons with NaN are false, so this catches it too.
        good = good and moved < span and sped < speed
        moved_sum += moved
        sped_sum += sped
    if good and sped_sum <= energy * len(nodes):
        return 0
    # Values, not members: Numba before 0.61 makes no one type of a member and a number.
    return Fault.RUNAWAY.value if moved_sum + sped_sum < math.inf else Fault.NOT_FINITE.value


@kernel
def keep(model: Model, state: State, scratch: Scratch) -> None:
    """Keep this shape as the last valid one; that of the whole organ only every few ticks, as copying it takes time."""
    if state.status.region != Region.WHOLE:
        copy_nodes(state.position, state.good_position, checked_nodes(model, state, scratch))
        state.status.good_age = KEEP_EVERY
        return
    state.status.good_age += 1
    if state.status.good_age >= KEEP_EVERY:
        copy(state.position, state.good_position)
        state.status.good_age = 0


@kernel
def check_cells(model: Model, state: State, scratch: Scratch) -> None:
    """Mark which of the next few cells are inverted; state.status.turned holds the number of all inverted cells.

    Parameters
    ----------
    model : Model
        Constants of the model.
    state : State
        State of the simulation; updated.
    scratch : Scratch
        Working memory; updated.
    """
    status, cells, x, is_turned = state.status, model.cells, state.position, state.is_turned
    if len(cells) == 0:
        return
    cell = status.next_cell
    for _ in range(min(CELLS_A_TICK, len(cells))):
        a, b, c, d = cells[cell, 0], cells[cell, 1], cells[cell, 2], cells[cell, 3]
        ax, ay, az = x[a, 0] - x[d, 0], x[a, 1] - x[d, 1], x[a, 2] - x[d, 2]
        bx, by, bz = x[b, 0] - x[d, 0], x[b, 1] - x[d, 1], x[b, 2] - x[d, 2]
        cx, cy, cz = x[c, 0] - x[d, 0], x[c, 1] - x[d, 1], x[c, 2] - x[d, 2]
        volume = ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)
        turned = 1 if volume < 0.0 and are_placed(model, state, scratch, cells[cell]) else 0
        status.turned += turned - is_turned[cell]
        is_turned[cell] = turned
        cell = cell + 1 if cell + 1 < len(cells) else 0
    status.next_cell = cell
