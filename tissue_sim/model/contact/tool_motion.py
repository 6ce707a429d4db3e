"""Motion of the bodies of tools in a tick, and the freshness of their poses and forces."""

from __future__ import annotations

import math

from tissue_sim.array_types import Floats
from tissue_sim.jit import kernel
from tissue_sim.model.contact.gap import is_touched
from tissue_sim.model.contact.poses import distance, distance_along_path, set_frame, step_pose
from tissue_sim.model.contact.walls import leave_wall
from tissue_sim.model.data.arrays import copy
from tissue_sim.model.data.contact_set import POINT_NODES
from tissue_sim.model.data.scratch import Scratch
from tissue_sim.model.data.settings import Settings
from tissue_sim.model.data.shapes import Shapes
from tissue_sim.model.data.state import BodyStatus, State

ROUNDING = 1e-6  # fraction of a tick below which a time counts as zero
# Near tissue, a body moves in a step by at most this fraction of its finest feature: points in front of it are then in
# its front half at the end, and are pushed forward, not past it.
STEP = 0.25
WALL_ROUNDS = 4  # rounds in a step that move a tool out of fixed tissue: a corner has three walls
SLOWING_RANGE = 0.3  # last fraction of the bearable force, in which a tool that slipped is slowed and held
INWARD_COSINE = 0.25  # cosine between a tool's motion and the force against it, from which it presses deeper
RECENT_DECAY = 0.99  # by which the largest recent force, the mean one, and the largest recent speed decay in a tick
FIRST_RETRY_SPEED, LATER_RETRY_SPEED = 0.4, 0.1  # m/s, of a tool that presses again after one slip, and after more
AFTER_SLIP = 2  # factor on the substeps while a tool presses that has slipped; a larger one would not prevent slips
MAX_FAST_SLIPS = 2  # slips that may be due to speed, after each of which a tool presses again more slowly
RESUME_TIME = 1.0  # s without poses after which a returning hand counts as new
MAX_CATCH_UP_SPEED = 1.0  # m/s, of a body that catches up near tissue: well below the speed of sound in tissue


@kernel
def freshness(age: int, settings: Settings) -> float:
    """Return 1 while an input is fresh, then a factor that decreases linearly to 0; 0 if there was no input.

    Parameters
    ----------
    age : int
        Ticks since the input; negative if there was none.
    settings : Settings
        Settings of the simulation.
    """
    if age < 0:
        return 0.0
    late = age * settings.tick_time - settings.stale_time
    if late <= 0.0:
        return 1.0
    return max(0.0, 1.0 - late / settings.ramp_time)


@kernel
def advance_held(state: State, settings: Settings, scratch: Scratch) -> None:
    """Move the held pose of each body towards its newest pose; release the body when poses stop.

    Parameters
    ----------
    state : State
        State of the simulation; updated.
    settings : Settings
        Settings of the simulation.
    scratch : Scratch
        Working memory; updated.
    """
    for body in range(len(state.held_pose)):
        status = state.bodies[body]
        copy(state.held_pose[body], scratch.held[body])
        status.recent_speed = max(status.speed, RECENT_DECAY * status.recent_speed)
        if status.age >= 0:
            status.age += 1
            is_late = status.age * settings.tick_time > settings.stale_time + settings.ramp_time
            if is_late and not status.released:
                release_body(status)
            if status.released and status.age * settings.tick_time >= RESUME_TIME:
                status.cutting = False
        if status.force_age >= 0:
            status.force_age += 1
        if status.remaining > 0.0:
            arrives = status.remaining < (1.0 + ROUNDING) * settings.tick_time
            fraction = 1.0 if arrives else settings.tick_time / status.remaining
            step_pose(state.held_pose[body], state.body_goal[body], fraction)
            status.remaining = 0.0 if arrives else status.remaining - settings.tick_time
        set_frame(state.held_pose[body], scratch.origin[body], scratch.rotation[body])


@kernel
def release_body(status: BodyStatus) -> None:
    """Release a body whose poses stopped: its next pose may be anywhere.

    A blade in tissue remains there and holds it, without a force on the hand, as long as poses may resume.

    Parameters
    ----------
    status : BodyStatus
        Status of the body; updated.
    """
    status.resisted, status.placed = status.engaged or status.resisted, not status.held_off
    status.engaged = status.held_off = False
    forget_slips(status)
    status.released = True
    status.releases += 1


@kernel
def forget_slips(status: BodyStatus) -> None:
    """Reset the slips of a body, and the recent forces on it.

    Parameters
    ----------
    status : BodyStatus
        Status of the body; updated.
    """
    status.recent_force = status.bearable = 0.0
    status.slips = 0
    status.outward[:] = 0.0


@kernel
def follow_untouched(state: State, shapes: Shapes, settings: Settings, scratch: Scratch) -> bool:
    """Move every body to its held pose while no body touches tissue.

    scratch.origin and scratch.rotation remain those of the held poses.

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

    Returns
    -------
    bool
        False if a body would touch the tissue; then none is moved.
    """
    copy(state.body_pose, scratch.before)
    copy(state.held_pose, scratch.goal)
    advance_bodies(state, shapes, scratch, settings.tick_time)
    for body in range(len(state.body_pose)):
        set_frame(state.body_pose[body], scratch.origin[body], scratch.rotation[body])
    touched = is_touched(state, shapes, scratch.origin, scratch.rotation)
    for body in range(len(state.body_pose)):
        set_frame(state.held_pose[body], scratch.origin[body], scratch.rotation[body])
    if touched:
        copy(scratch.before, state.body_pose)
        return False
    state.wrench[:] = 0.0
    state.unfaded_wrench[:] = 0.0
    for body in range(len(state.bodies)):
        forget_slips(state.bodies[body])
    return True


@kernel
def advance_bodies(state: State, shapes: Shapes, scratch: Scratch, step: float) -> None:
    """Move every body towards scratch.goal (T, 7) as far as it may in a step, s; those of one tool together."""
    for body in range(len(state.body_pose)):
        fraction = 1.0
        for other in range(len(state.body_pose)):
            if shapes.tool[other] == shapes.tool[body]:
                most = largest_speed(state, scratch, other) * step
                fraction = min(fraction, free_distance(state, shapes, scratch, other, most))
        scratch.fraction[body] = fraction
    for body in range(len(state.body_pose)):
        if scratch.fraction[body] > 0.0:
            step_pose(state.body_pose[body], scratch.goal[body], scratch.fraction[body])
    for _ in range(WALL_ROUNDS if scratch.n_walls[0] > 0 else 0):
        if not leave_wall(state, shapes, scratch):
            break


@kernel
def largest_speed(state: State, scratch: Scratch, body: int) -> float:
    """Return the largest speed, m/s, at which a body may move to its goal near tissue."""
    # Contact undoes the motion that a pressing spring adds: a bound on speed would bound the spring's force.
    if scratch.give[body] > 0.0 and has_contact(state, body):
        return math.inf
    slips = state.bodies[body].slips
    if slips == 0 or not leads_inward(state, body, scratch.goal[body]):
        return MAX_CATCH_UP_SPEED
    return FIRST_RETRY_SPEED if slips < MAX_FAST_SLIPS else LATER_RETRY_SPEED


@kernel
def has_contact(state: State, body: int) -> bool:
    """Return whether a body touched tissue in the last tick."""
    unfaded = state.unfaded_wrench[body]
    return unfaded[0] != 0.0 or unfaded[1] != 0.0 or unfaded[2] != 0.0


@kernel
def free_distance(state: State, shapes: Shapes, scratch: Scratch, body: int, most: float) -> float:
    """Return the fraction of the distance to its goal that a body may move in a step without missing any tissue.

    most: m that it may move near tissue, at its largest speed. It moves no farther than the contact set reaches, and
    waits for the next one; near tissue, it moves no faster than the points in front of it can be pushed. A body for
    which no set was searched yet waits; one that nothing resists moves freely.
    """
    status, contacts, extent, goal = state.bodies[body], state.contacts, shapes.extent[body], scratch.goal[body]
    if not status.engaged:
        return 0.0 if status.placed else 1.0
    pose, place, fraction = state.body_pose[body], contacts.place[body], 1.0
    way = distance_along_path(pose, goal, extent)
    touches = contacts.n_points[body] > 0 and shapes.finest[body] > 0.0
    if touches:
        most = min(STEP * shapes.finest[body], most)
    # A blade in tissue is held by places of its own, without contact points.
    if (touches or status.cutting) and way > most:
        fraction = most / way
    # Distances are convex: a fraction of the motion adds at most that fraction of the change by the whole motion.
    now, then = distance_along_path(pose, place, extent), distance_along_path(goal, place, extent)
    if then > contacts.reach[body] and then > now:
        fraction = min(fraction, max(0.0, contacts.reach[body] - now) / (then - now))
    # A coupling limits its own force, see `couple_bodies`.
    if is_force_limited(status) and scratch.give[body] == 0.0 and leads_inward(state, body, goal):
        fraction *= min(1.0, max(0.0, (1.0 - status.recent_force / status.bearable) / SLOWING_RANGE))
    return fraction


@kernel
def slip_substep_factor(state: State) -> int:
    """Return the factor on the number of substeps until all tools that have slipped are free again.

    Parameters
    ----------
    state : State
        State of the simulation.
    """
    for body in range(len(state.bodies)):
        if state.bodies[body].slips > 0:
            return AFTER_SLIP
    return 1


@kernel
def is_force_limited(status: BodyStatus) -> bool:
    """Return whether the force of a body is limited to `bearable`, since it has slipped."""
    return status.slips > MAX_FAST_SLIPS and not status.cutting


@kernel
def leads_inward(state: State, body: int, goal: Floats) -> bool:
    """Return whether the motion to a goal (7,) is against the force of the tissue."""
    outward, pose, along, size, way = state.bodies[body].outward, state.body_pose[body], 0.0, 0.0, 0.0
    for c in range(3):
        along += outward[c] * (goal[c] - pose[c])
        size += outward[c] ** 2
        way += (goal[c] - pose[c]) ** 2
    return along < -INWARD_COSINE * math.sqrt(size * way)


@kernel
def note_forces(state: State, settings: Settings, scratch: Scratch) -> None:
    """Update the recent forces of the tissue on every body; reset the slips of one that has reached its hand freely.

    Parameters
    ----------
    state : State
        State of the simulation; updated.
    settings : Settings
        Settings of the simulation.
    scratch : Scratch
        Working memory, with the impulses of this tick.
    """
    for body in range(len(state.bodies)):
        status, impulse = state.bodies[body], scratch.impulse[body]
        size = math.sqrt(impulse[0] * impulse[0] + impulse[1] * impulse[1] + impulse[2] * impulse[2])
        status.recent_force = max(size / settings.tick_time, RECENT_DECAY * status.recent_force)
        # The last forces before a slip may point sideways; a tool that has slipped keeps the side from which it came.
        for c in range(3 if status.slips == 0 else 0):
            status.outward[c] = (
                RECENT_DECAY * status.outward[c] - (1.0 - RECENT_DECAY) * impulse[c] / settings.tick_time
            )
        if size == 0.0 and status.slips > 0 and distance(state.body_pose[body], state.held_pose[body]) == 0.0:
            forget_slips(status)


@kernel
def couple_bodies(
    state: State, shapes: Shapes, settings: Settings, scratch: Scratch, step: float, fraction: float
) -> None:
    """Move the held poses of the bodies along their paths, and each body after its held pose by the virtual coupling.

    A body has no mass: B p' = K (h - p) + F. This function computes a step without contact; the displacement per
    impulse of the contact is scratch.give, m / (N s). The held pose moves at constant speed through the tick, so that
    its speed has no jumps. A body lags behind if it may not move as far, see `free_distance`.

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
    step : float, s
        The substep.
    fraction : float
        Fraction of the rest of the tick's motion.
    """
    stiffness, damping = settings.coupling_stiffness, settings.coupling_damping
    for body in range(len(state.body_pose)):
        held, pose = scratch.held[body], state.body_pose[body]
        set_frame(pose, scratch.last_origin[body], scratch.last_rotation[body])
        step_pose(held, state.held_pose[body], fraction)
        copy(held, scratch.goal[body])
        # A released body, a blade that holds tissue, stays where it is.
        is_coupled = stiffness > 0.0 and not state.bodies[body].released
        scratch.give[body] = 1.0 / (damping + stiffness * step) if is_coupled else 0.0
    for body in range(len(state.body_pose) if stiffness > 0.0 else 0):
        scratch.fraction[body] = spring_fraction(state, shapes, scratch, body, stiffness * step)
    for body in range(len(state.body_pose)):
        if scratch.give[body] > 0.0:
            held, pose, status = scratch.held[body], state.body_pose[body], state.bodies[body]
            scratch.give[body] *= scratch.fraction[body]
            pull = stiffness * distance(pose, held)
            # If it were slowed like a rigid body, it would be pushed out and return again and again.
            eased = status.bearable / pull if is_force_limited(status) and pull > status.bearable else 1.0
            for c in range(3):
                scratch.goal[body, c] = pose[c] + scratch.give[body] * stiffness * step * eased * (held[c] - pose[c])
    if scratch.n_walls[0] > 0:
        scratch.wall_push[:] = 0.0
        copy(scratch.impulse, scratch.wall_before)
    advance_bodies(state, shapes, scratch, step)
    for body in range(len(state.body_pose)):
        set_frame(state.body_pose[body], scratch.origin[body], scratch.rotation[body])


@kernel
def spring_fraction(state: State, shapes: Shapes, scratch: Scratch, body: int, impulse: float) -> float:
    """Return the factor on a body's displacement per impulse, so that no body of its tool moves too far in a step.

    A small tool that is pressed may not move as far as its spring would move it. A larger damper slows it as much, and
    transmits the whole force of the spring.

    impulse: N s/m, that of the spring in the step, for a metre.
    """
    fraction = 1.0
    for other in range(len(state.body_pose)):
        if shapes.tool[other] == shapes.tool[body] and shapes.finest[other] > 0.0 and has_contact(state, other):
            way = scratch.give[other] * impulse * distance(state.body_pose[other], scratch.held[other])
            fraction = min(fraction, STEP * shapes.finest[other] / max(way, ROUNDING * shapes.finest[other]))
    return fraction


@kernel
def store_body_poses(state: State, scratch: Scratch) -> None:
    """Copy the places to which contact has pushed the tools to their poses.

    Parameters
    ----------
    state : State
        State of the simulation; updated.
    scratch : Scratch
        Working memory; updated.
    """
    for body in range(len(state.body_pose)):
        if scratch.give[body] > 0.0:
            copy(scratch.origin[body], state.body_pose[body, :3])


@kernel
def restore_bodies(state: State, farthest: float) -> None:
    """Return bodies that contact has pushed out of bounds, or to NaN, to the poses of their contact set.

    Parameters
    ----------
    state : State
        State of the simulation; updated.
    farthest : float, m
        Largest displacement allowed.
    """
    for body in range(len(state.body_pose)):
        back = state.contacts.place[body] if state.bodies[body].engaged else state.held_pose[body]
        square = 0.0
        for c in range(3):
            square += (state.body_pose[body, c] - back[c]) ** 2
        if not square < farthest * farthest:
            copy(back, state.body_pose[body])


@kernel
def has_tip_force(state: State, settings: Settings) -> bool:
    """Return whether an external force acts on the tissue under any tool's tip.

    Parameters
    ----------
    state : State
        State of the simulation; updated.
    settings : Settings
        Settings of the simulation.
    """
    for body in range(len(state.body_force)):
        if state.contacts.tip_node[body, 0] >= 0 and freshness(state.bodies[body].force_age, settings) > 0.0:
            force = state.body_force[body]
            if force[0] != 0.0 or force[1] != 0.0 or force[2] != 0.0:
                return True
    return False


@kernel
def add_tip_forces(state: State, settings: Settings, force: Floats) -> None:
    """Add the external forces at the tools' tips.

    Parameters
    ----------
    state : State
        State of the simulation; updated.
    settings : Settings
        Settings of the simulation.
    force : Floats, shape (n, 3), N
        Forces on the nodes; updated.
    """
    for body in range(len(state.body_force)):
        fresh = freshness(state.bodies[body].force_age, settings)
        if fresh > 0.0 and state.contacts.tip_node[body, 0] >= 0:
            for c in range(POINT_NODES):
                node, weight = state.contacts.tip_node[body, c], fresh * state.contacts.tip_weight[body, c]
                for axis in range(3):
                    force[node, axis] += weight * state.body_force[body, axis]
