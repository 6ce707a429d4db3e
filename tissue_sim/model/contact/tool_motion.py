"""How the bodies of tools move through a tick, and how fresh their poses and forces are."""

from __future__ import annotations

import math

from tissue_sim.array_types import Floats
from tissue_sim.jit import kernel
from tissue_sim.model.contact.gap import gap_and_normal, is_on_outer_side, is_touched, point_in_body
from tissue_sim.model.contact.shapes import rotation_matrix, signed_distance
from tissue_sim.model.data.arrays import copy
from tissue_sim.model.data.contact_set import POINT_NODES, nodes_of
from tissue_sim.model.data.model import Model
from tissue_sim.model.data.scratch import Scratch
from tissue_sim.model.data.settings import Settings
from tissue_sim.model.data.shapes import Shapes
from tissue_sim.model.data.state import BodyStatus, State

ROUNDING = 1e-6  # fraction of a tick that counts as zero
# Where tissue is near, a body moves in a step by at most this fraction of its finest feature: points before it then
# end in its front half, and are pushed on, not past it.
STEP = 0.25
WALL = 0.5  # of a body's finest feature: it enters fixed tissue by at most that, so its middle stays outside
MOVES = 0.5  # of a contact point's weights: with less on moving nodes it counts as fixed
WALL_ROUNDS = 4  # rounds in a step that move a tool out of fixed tissue: a corner has three walls
FASTEST = 1.0  # m/s, of a body that catches up there: well below the speed of sound in tissue


@kernel
def freshness(age: int, settings: Settings) -> float:
    """Return 1 while an input is fresh, falling linearly to 0 after it went stale; 0 when there was none.

    Parameters
    ----------
    age : int
        Ticks since the input; below 0: there was none.
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
    """Move the place where each body is held towards its newest pose; release it when poses stop.

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
        if status.age >= 0:
            status.age += 1
            is_late = status.age * settings.tick_time > settings.stale_time + settings.ramp_time
            if is_late and not status.released:
                release_body(status)
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
    """End the life of a body whose poses stopped: its next pose may be anywhere.

    Parameters
    ----------
    status : BodyStatus
        Status of the body; updated.
    """
    status.resisted, status.placed = status.engaged or status.resisted, not status.held_off
    status.engaged = status.held_off = status.cutting = False
    status.released = True
    status.releases += 1


@kernel
def follow_untouched(state: State, shapes: Shapes, settings: Settings, scratch: Scratch) -> bool:
    """Move every body on while no body touches tissue.

    scratch.origin and scratch.rotation remain those of where the bodies are held.

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
        False when a body would touch the tissue; none is moved then.
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
    return True


@kernel
def advance_bodies(state: State, shapes: Shapes, scratch: Scratch, step: float) -> None:
    """Move every body towards scratch.goal (T, 7) as far as it may in a step, s; those of one tool together."""
    for body in range(len(state.body_pose)):
        fraction = 1.0
        for other in range(len(state.body_pose)):
            if shapes.tool[other] == shapes.tool[body]:
                # Contact takes back what a pressing spring adds to the way: a bound on speed would bound its force.
                is_pressed = scratch.give[other] > 0.0 and has_contact(state, other)
                most = math.inf if is_pressed else FASTEST * step
                fraction = min(fraction, free_distance(state, shapes, other, scratch.goal[other], most))
        scratch.fraction[body] = fraction
    for body in range(len(state.body_pose)):
        if scratch.fraction[body] > 0.0:
            step_pose(state.body_pose[body], scratch.goal[body], scratch.fraction[body])
    for _ in range(WALL_ROUNDS if scratch.walls[0] > 0 else 0):
        if not leave_wall(state, shapes, scratch):
            break


@kernel
def find_walls(model: Model, state: State, scratch: Scratch) -> None:
    """List the contact points on mostly fixed nodes in scratch.wall: they hardly yield to a tool.

    Parameters
    ----------
    model : Model
        Constants of the model.
    state : State
        State of the simulation; updated.
    scratch : Scratch
        Working memory; updated.
    """
    count, contacts = 0, state.contacts
    for entry in range(contacts.header.points):
        moves = 0.0
        for c in range(nodes_of(contacts, entry)):
            if model.inverse_mass[contacts.node[entry, c]] > 0.0:
                moves += contacts.weight[entry, c]
        status = state.bodies[contacts.body[entry]]
        if moves < MOVES and status.engaged and not status.cutting:
            scratch.wall[count] = entry
            count += 1
    scratch.walls[0] = count


@kernel
def leave_wall(state: State, shapes: Shapes, scratch: Scratch) -> bool:
    """Move a tool out of the fixed point that lies deepest in it; return False where none lies deeper than WALL.

    Tissue that moves is pushed on by the tool; into fixed tissue it would go on until it has slipped inside.
    """
    deepest, chosen = 0.0, -1
    x = y = z = 0.0
    for index in range(scratch.walls[0]):
        entry = scratch.wall[index]
        body = state.contacts.body[entry]
        if index == 0 or body != state.contacts.body[scratch.wall[index - 1]]:
            set_frame(state.body_pose[body], scratch.origin[body], scratch.rotation[body])
        _, _, _, lx, ly, lz = point_in_body(state, entry, scratch.origin, scratch.rotation)
        deep = -signed_distance(shapes, body, lx, ly, lz)[0] - WALL * shapes.finest[body]
        if deep > deepest:  # hardly ever: only then the normal is looked at
            _, nx, ny, nz = gap_and_normal(shapes, body, scratch.rotation[body], lx, ly, lz)
            if is_on_outer_side(state, entry, (nx, ny, nz)):
                deepest, chosen, x, y, z = deep, body, nx, ny, nz
    if chosen < 0:
        return False
    for body in range(len(state.body_pose)):
        if shapes.tool[body] == shapes.tool[chosen]:
            pose = state.body_pose[body]
            pose[0], pose[1], pose[2] = pose[0] - deepest * x, pose[1] - deepest * y, pose[2] - deepest * z
    return True


@kernel
def has_contact(state: State, body: int) -> bool:
    """Return whether a body touched tissue in the last tick."""
    unfaded = state.unfaded_wrench[body]
    return unfaded[0] != 0.0 or unfaded[1] != 0.0 or unfaded[2] != 0.0


@kernel
def free_distance(state: State, shapes: Shapes, body: int, goal: Floats, most: float) -> float:
    """Return the fraction of its way to a goal (7,) that a body may go in a step and meet all tissue on it.

    most: m that it may go where tissue is near, at its speed. It goes no farther than the contact set knows the surface
    around it, and waits for the next one; where there is tissue, it goes no faster than points before it can be pushed.
    A body that no set has looked at yet waits; one that nothing resists goes freely.
    """
    status, contacts, extent = state.bodies[body], state.contacts, shapes.extent[body]
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
    # Distances are convex: a fraction of the way adds at most that fraction of what the whole way adds.
    now, then = distance_along_path(pose, place, extent), distance_along_path(goal, place, extent)
    if then > contacts.reach[body] and then > now:
        fraction = min(fraction, max(0.0, contacts.reach[body] - now) / (then - now))
    return fraction


@kernel
def distance_along_path(pose: Floats, other: Floats, extent: float) -> float:
    """Return a bound on how far the points of a body lie apart in two poses.

    Parameters
    ----------
    pose : Floats, shape (7,)
        A pose.
    other : Floats, shape (7,)
        Another pose.
    extent : float, m
        Largest distance of its points from its origin.

    Returns
    -------
    float
        m
    """
    if extent == 0.0:
        return distance(pose, other)
    # A chord between unit quaternions is 2 sin(angle / 4), and a point moves by 2 sin(angle / 2) of its arm.
    return distance(pose, other) + 2.0 * extent * quaternion_distance(pose, other)


@kernel
def distance(pose: Floats, other: Floats) -> float:
    """Return the distance between the origins of two poses.

    Parameters
    ----------
    pose : Floats, shape (7,)
        A pose.
    other : Floats, shape (7,)
        Another pose.

    Returns
    -------
    float
        m
    """
    return math.sqrt((pose[0] - other[0]) ** 2 + (pose[1] - other[1]) ** 2 + (pose[2] - other[2]) ** 2)


@kernel
def quaternion_distance(pose: Floats, other: Floats) -> float:
    """Return the chord between the quaternions of two poses, of either sign: half the angle where it is small.

    Parameters
    ----------
    pose : Floats, shape (7,)
        A pose.
    other : Floats, shape (7,)
        Another pose.
    """
    less = more = 0.0
    for c in range(3, 7):
        less += (pose[c] - other[c]) ** 2
        more += (pose[c] + other[c]) ** 2
    return math.sqrt(min(less, more))


@kernel
def couple_bodies(
    state: State, shapes: Shapes, settings: Settings, scratch: Scratch, step: float, fraction: float
) -> None:
    """Move where the bodies are held along their way, and each body after it through the virtual coupling.

    A body has no mass: B p' = K (h - p) + F, of which a step without contact is done here; the displacement per impulse
    of the contact is scratch.give, m / (N s). The held pose moves evenly through the tick, so that its speed has no
    jumps. A body is behind where it may not go as far, see `free_distance`.

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
        Fraction of the rest of the tick's way.
    """
    stiffness, damping = settings.coupling_stiffness, settings.coupling_damping
    for body in range(len(state.body_pose)):
        held, pose = scratch.held[body], state.body_pose[body]
        set_frame(pose, scratch.last_origin[body], scratch.last_rotation[body])
        step_pose(held, state.held_pose[body], fraction)
        goal = scratch.goal[body]
        copy(held, goal)
        scratch.give[body] = 0.0
        if stiffness > 0.0:
            scratch.give[body] = 1.0 / (damping + stiffness * step)
            for c in range(3):
                goal[c] = pose[c] + scratch.give[body] * stiffness * step * (held[c] - pose[c])
    advance_bodies(state, shapes, scratch, step)
    for body in range(len(state.body_pose)):
        set_frame(state.body_pose[body], scratch.origin[body], scratch.rotation[body])


@kernel
def keep_bodies(state: State, scratch: Scratch) -> None:
    """Copy to the poses where contact has pushed the tools.

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
    """Return bodies that contact has pushed out of bounds, or to no number, to where their contact points were found.

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
def step_pose(pose: Floats, goal: Floats, fraction: float) -> None:
    """Move a pose (7,) by a fraction of the way to a goal; the quaternion by normalised lerp."""
    if fraction >= 1.0:
        copy(goal, pose)
        return
    for c in range(3):
        pose[c] += fraction * (goal[c] - pose[c])
    dot = pose[3] * goal[3] + pose[4] * goal[4] + pose[5] * goal[5] + pose[6] * goal[6]
    sign = 1.0 if dot >= 0.0 else -1.0
    norm = 0.0
    for c in range(3, 7):
        pose[c] += fraction * (sign * goal[c] - pose[c])
        norm += pose[c] * pose[c]
    norm = 1.0 / math.sqrt(norm)
    for c in range(3, 7):
        pose[c] *= norm


@kernel
def set_frame(pose: Floats, origin: Floats, rotation: Floats) -> None:
    """Write the origin and the rotation matrix of a pose.

    Parameters
    ----------
    pose : Floats, shape (7,), m and quaternion xyzw
        The pose.
    origin : Floats, shape (3,), m
        Its origin; updated.
    rotation : Floats, shape (9,)
        Its rotation matrix, row by row; updated.
    """
    copy(pose[:3], origin)
    rotation_matrix(pose[3:], rotation)


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
