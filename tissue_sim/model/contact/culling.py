"""Selection of the contact points that a tick examines: a contact set has many, since it is used for several ticks."""

from __future__ import annotations

import math

from tissue_sim.array_types import Floats
from tissue_sim.jit import kernel
from tissue_sim.model.contact.gap import point_in_body
from tissue_sim.model.contact.poses import set_frame
from tissue_sim.model.contact.shapes import signed_distance
from tissue_sim.model.contact.tool_motion import MAX_CATCH_UP_SPEED
from tissue_sim.model.data.scratch import Scratch
from tissue_sim.model.data.settings import Settings
from tissue_sim.model.data.shapes import Shapes
from tissue_sim.model.data.state import Region, State

FAST = 0.5  # m/s, largest speed of tissue towards a tool within a tick


@kernel
def cull_contacts(state: State, shapes: Shapes, settings: Settings, scratch: Scratch) -> None:
    """List the contact points that may touch in the coming tick in scratch.candidates; clear the impulses of others.

    Points are left out that can't touch, neither by the tool's motion from its pose to the held one, nor by tissue that
    approaches at FAST. Call this after advance_held; scratch.last_* are set to the tools' present poses.

    Parameters
    ----------
    state : State
        State of the simulation; updated.
    shapes : Shapes
        Shapes of the bodies.
    settings : Settings
        Settings of the simulation.
    scratch : Scratch
        Working memory; updated.
    """
    body, moved, turned, count = -1, 0.0, 0.0, 0
    most = MAX_CATCH_UP_SPEED * settings.tick_time if settings.coupling_stiffness == 0.0 else math.inf
    for entry in range(state.contacts.header.points):
        if body != state.contacts.body[entry]:
            body = state.contacts.body[entry]
            set_frame(state.body_pose[body], scratch.last_origin[body], scratch.last_rotation[body])
            moved, turned = motion_of(settings, scratch, body)
        gap = reach = 0.0
        candidate = state.contact_pressed[0, entry] > 0.0
        if state.bodies[body].engaged:
            _, _, _, lx, ly, lz = point_in_body(state, entry, scratch.last_origin, scratch.last_rotation)
            reach = min(most, moved + turned * math.sqrt(lx * lx + ly * ly + lz * lz)) + FAST * settings.tick_time
            if not candidate:
                gap = signed_distance(shapes, body, lx, ly, lz)[0]
                candidate = gap < reach
        if candidate:
            scratch.candidates[count] = entry
            scratch.candidate_gap[count], scratch.candidate_speed[count] = gap, reach / settings.tick_time - FAST
            count += 1
        else:
            state.contact_pressed[0, entry] = 0.0
            state.contact_held[0, entry] = 0.0
    scratch.n_candidates[0] = count


@kernel
def largest_tissue_speed(state: State) -> float:
    """Return a bound on the speed of tissue towards a tool in a substep; contact may add as much again.

    It is less than FAST only if nothing but the velocities moves the organ.

    Parameters
    ----------
    state : State
        State of the simulation.

    Returns
    -------
    float
        m/s
    """
    if state.status.region != Region.WHOLE:
        return FAST
    # Four at a time, as each comparison would wait for the previous one.
    velocity, whole = state.velocity, len(state.velocity) // 4 * 4
    a = b = c = d = 0.0
    for node in range(0, whole, 4):
        a = larger(a, square_of(velocity, node))
        b = larger(b, square_of(velocity, node + 1))
        c = larger(c, square_of(velocity, node + 2))
        d = larger(d, square_of(velocity, node + 3))
    for node in range(whole, len(velocity)):
        a = larger(a, square_of(velocity, node))
    return min(FAST, 2.0 * math.sqrt(max(a, b, c, d)))


@kernel
def larger(most: float, value: float) -> float:
    """Return the larger of two numbers, or the first one if the second is NaN."""
    return value if value > most else most


@kernel
def square_of(vectors: Floats, index: int) -> float:
    """Return the squared length of one of some vectors, (n, 3)."""
    return vectors[index, 0] ** 2 + vectors[index, 1] ** 2 + vectors[index, 2] ** 2


@kernel
def motion_of(settings: Settings, scratch: Scratch, body: int) -> tuple[float, float]:
    """Return bounds on the displacement of a body's origin in this tick, m, and on its rotation, rad.

    A virtual coupling moves it by a part of these.
    """
    square = turn = 0.0
    for axis in range(3):
        square += (scratch.origin[body, axis] - scratch.last_origin[body, axis]) ** 2
    for index in range(9):
        turn += (scratch.rotation[body, index] - scratch.last_rotation[body, index]) ** 2
    stiff = settings.coupling_stiffness * settings.tick_time
    led = stiff / settings.coupling_damping if stiff < settings.coupling_damping else 1.0
    return (led if stiff > 0.0 else 1.0) * math.sqrt(square), math.sqrt(turn)
