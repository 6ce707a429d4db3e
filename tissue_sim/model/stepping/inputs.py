"""Inputs from outside, applied before a tick: by the node's loop, by a test, by a replay."""

from __future__ import annotations

import math

from tissue_sim.array_types import Floats, Longs
from tissue_sim.jit import kernel
from tissue_sim.model.contact.blade_places import forget_blades
from tissue_sim.model.contact.poses import distance, distance_along_path, quaternion_distance
from tissue_sim.model.contact.tool_motion import FIRST_RETRY_SPEED, MAX_FAST_SLIPS, RESUME_TIME, forget_slips
from tissue_sim.model.data.arrays import copy
from tissue_sim.model.data.contact_set import POINT_NODES, ContactSet, Engaged, used_words
from tissue_sim.model.data.model import Model
from tissue_sim.model.data.shapes import Shapes
from tissue_sim.model.data.state import State
from tissue_sim.model.data.world import World
from tissue_sim.model.regions.active_region import drop_region
from tissue_sim.model.stepping.prescribed import forget_prescribed
from tissue_sim.model.stepping.relaxation import forget_relaxation

CATCH_UP_TIME = 0.03  # s in which a tool makes up most of its lag behind its poses, unless these were slower
MAX_BACKOFF = 8  # highest factor on the substeps
LAG_TOLERANCE = 1e-4  # m that a tool may lag behind its hand without counting as fast
BEARABLE_FRACTION = 0.7  # of the force at which a tool slipped, up to which it is pressed from then on
SWALLOWED_FRACTION = 0.97  # of the bearable force, when swinging tissue swallowed the tool without such a force
MIN_SLIP_FORCE = 0.05  # N, least force at which a tool counts as having slipped
MIN_APPROACH = 1e-3, 1e-2  # m/s and 1/s, least speeds of a tool, so that it arrives


@kernel
def take_pose(world: World, body: int, pose: Floats, stamp: int, sequence: int) -> None:
    """Apply the newest pose of a body.

    The first pose puts the tool there, and so does any pose while nothing resists it; it is moved to others. Where
    poses resume after a pause of at most RESUME_TIME while the tool was resisted, it is resisted at its last place.

    Parameters
    ----------
    world : World
        World of the organ; updated.
    body : int
        Index of the body.
    pose : Floats, shape (7,)
        Position, m, and unit quaternion xyzw.
    stamp : int, ns
        Time of the pose, 0 where unknown.
    sequence : int
        Number of the pose.
    """
    state = world.state
    status = state.bodies[body]
    if status.age < 0 or status.released or status.held_off:
        goes_on = status.released and status.placed and status.age * world.settings.tick_time < RESUME_TIME
        if not goes_on:
            copy(pose, state.body_pose[body])
        copy(pose, state.held_pose[body])
        status.remaining = status.speed = status.turning = 0.0
        status.resisted = status.resisted and goes_on
        status.placed = not status.held_off
        status.released = False
    else:
        move_tool_towards(world, body, pose, stamp)
    copy(pose, state.body_goal[body])
    status.age = 0
    status.stamp = stamp
    status.pose_sequence = sequence


@kernel
def move_tool_towards(world: World, body: int, pose: Floats, stamp: int) -> None:
    """Set the speed at which a tool moves to a pose (7,): at most that of its poses, by their stamps or arrival times.

    If poses were skipped or late, the tool lags behind them. It catches up smoothly, and no faster than the poses
    moved, so that a busy machine doesn't change the force. It never lags for longer than stale_time. The time of its
    motion is multiplied by its `smoothing`, and is at least a tick.
    """
    state, settings = world.state, world.settings
    status, held, goal = state.bodies[body], state.held_pose[body], state.body_goal[body]
    interval = 1e-9 * (stamp - status.stamp) if 0 < status.stamp < stamp else max(status.age, 1) * settings.tick_time
    before = status.remaining > 0.0
    moved, turned = distance(goal, pose), quaternion_distance(goal, pose)
    status.speed = max(moved / interval, status.speed if before else 0.0)
    status.turning = max(turned / interval, status.turning if before else 0.0)
    seconds = max(
        motion_time(distance(held, pose), moved, interval, status.speed, MIN_APPROACH[0]),
        motion_time(quaternion_distance(held, pose), turned, interval, status.turning, MIN_APPROACH[1]),
    )
    seconds = min(seconds, settings.stale_time)
    smoothed = max(world.shapes.smoothing[body] * seconds, settings.tick_time)
    status.remaining = min(seconds, smoothed)


@kernel
def motion_time(way: float, new: float, interval: float, most: float, creep: float) -> float:
    """Return the time, s, for a distance to which the last pose added `new`, in `interval` s; most: largest speed."""
    if way == 0.0:
        return 0.0
    return way / min(most, new / interval + max(0.0, way - new) / CATCH_UP_TIME + creep) if most > 0.0 else interval


@kernel
def take_force(state: State, body: int, force: Floats, sequence: int) -> None:
    """Apply the newest external force on the tissue at a tool's tip.

    Parameters
    ----------
    state : State
        State of the simulation; updated.
    body : int
        Index of the body.
    force : Floats, shape (3,), N
        The force.
    sequence : int
        Number of the force.
    """
    copy(force, state.body_force[body])
    state.bodies[body].force_age = 0
    state.bodies[body].force_sequence = sequence


@kernel
def take_contacts(state: State, shapes: Shapes, found: ContactSet, sequence: int) -> None:
    """Apply a contact set, unless it lacks the surface around a tool that is resisted.

    A tool may have moved since the set was found. Then it keeps the present set and moves no farther than that reaches;
    the next set covers it.

    Parameters
    ----------
    state : State
        State of the simulation; updated.
    shapes : Shapes
        Shapes of the bodies.
    found : ContactSet
        The contact set.
    sequence : int
        Its number.
    """
    contacts = state.contacts
    for body in range(len(state.bodies)):
        if state.bodies[body].engaged and not covers(state, shapes, found, body):
            return
    carry_impulses(state, found)
    for index in range(used_words(found)):
        contacts.words[index] = found.words[index]
    contacts.header.sequence = sequence
    for body in range(len(state.bodies)):
        status = state.bodies[body]
        # Points that were found before a body's last release don't belong to its present place.
        if status.age >= 0 and not status.released and found.releases[body] == status.releases:
            is_covered = covers(state, shapes, found, body)
            if found.engaged[body] == Engaged.SLIPPED and is_covered:
                put_back(state, body)
            status.engaged = status.engaged or is_covered
            status.resisted = status.resisted and not status.engaged
            # A body that slips without ever having been resisted appeared inside, too.
            is_inside = found.engaged[body] == Engaged.HELD_OFF or found.engaged[body] == Engaged.SLIPPED
            status.held_off = not status.engaged and (status.held_off or is_inside)
            status.placed = not status.held_off


@kernel
def covers(state: State, shapes: Shapes, found: ContactSet, body: int) -> bool:
    """Return whether a contact set has all surface points that a body may touch at its place, or where it is put."""
    status = state.bodies[body]
    if found.releases[body] != status.releases:
        return False
    way = distance_along_path(state.body_pose[body], found.place[body], shapes.extent[body])
    is_searched = found.engaged[body] == Engaged.YES or found.engaged[body] == Engaged.CUTS
    is_reached = is_searched and way <= found.reach[body]
    return is_reached or (found.engaged[body] == Engaged.SLIPPED and (status.engaged or status.resisted))


@kernel
def put_back(state: State, body: int) -> None:
    """Put a body that has slipped inside back on the surface, where it presses again, in shorter substeps.

    If the nearest surface is that of the organ's far side, the body moves as far against the direction in which it
    entered; the next contact set shows whether it is outside. Sets that were found before and arrive late would move it
    again, so they are ignored, as after a release. A fast tool then presses more slowly, up to twice. One that wasn't
    fast, or slips again, presses with less force than that at which it slipped, which the surface can't bear.
    """
    status, pose, place, ahead, size = state.bodies[body], state.body_pose[body], state.contacts.place[body], 0.0, 0.0
    is_hasty = status.recent_speed > FIRST_RETRY_SPEED or distance(pose, state.held_pose[body]) > LAG_TOLERANCE
    for c in range(3):
        ahead -= status.outward[c] * (place[c] - pose[c])
        size += status.outward[c] ** 2
    if ahead > 0.0:
        way = distance(pose, place) / math.sqrt(size)
        for c in range(3):
            pose[c] += way * status.outward[c]
        copy(pose, place)
        state.contacts.reach[body] = 0.0
    else:
        copy(place, pose)
    status.releases += 1
    if status.engaged:
        state.count.slips += 1
        # Tissue that swings back may swallow a tool that was just put on it, at any force.
        is_pressed = status.slips == 0 or status.recent_force > 0.5 * status.bearable
        borne = BEARABLE_FRACTION * max(status.recent_force, MIN_SLIP_FORCE)
        status.bearable = borne if is_pressed else SWALLOWED_FRACTION * status.bearable
        status.recent_force = 0.0
        status.slips += 1 if is_hasty or status.slips > 0 else MAX_FAST_SLIPS + 1


@kernel
def load_nodes(state: State, nodes: Longs, forces: Floats) -> None:
    """Add forces to nodes for the coming tick.

    Parameters
    ----------
    state : State
        State of the simulation; updated.
    nodes : Longs, shape (k,)
        Nodes.
    forces : Floats, shape (k, 3), N
        Forces.
    """
    for index in range(len(nodes)):
        load_node(state, nodes[index], forces[index, 0], forces[index, 1], forces[index, 2])


@kernel
def load_node(state: State, node: int, x: float, y: float, z: float) -> None:
    """Add a force to a node for the coming tick.

    Parameters
    ----------
    state : State
        State of the simulation; updated.
    node : int
        The node.
    x : float, N
        Component of the force.
    y : float, N
        Component of the force.
    z : float, N
        Component of the force.
    """
    if state.is_loaded[node] == 0:
        state.is_loaded[node] = 1
        state.loaded_node[state.status.loaded] = node
        state.status.loaded += 1
    force = state.nodal_force[node]
    force[0] += x
    force[1] += y
    force[2] += z


@kernel
def unload_nodes(state: State) -> None:
    """Remove the forces of load_nodes.

    Parameters
    ----------
    state : State
        State of the simulation; updated.
    """
    for index in range(state.status.loaded):
        node = state.loaded_node[index]
        state.is_loaded[node] = 0
        for c in range(3):
            state.nodal_force[node, c] = 0.0
    state.status.loaded = 0


@kernel
def carry_impulses(state: State, found: ContactSet) -> None:
    """Copy the last substep's impulses of contact points to the same points of a new contact set."""
    pressed, held, old_set, points = state.contact_pressed, state.contact_held, state.contacts, found.header.points
    pressed[1, :points] = 0.0
    held[1, :points] = 0.0
    for old in range(old_set.header.points):
        if pressed[0, old] <= 0.0:
            continue
        for point in range(points):
            same = found.body[point] == old_set.body[old]
            for c in range(POINT_NODES):
                same = same and found.node[point, c] == old_set.node[old, c]
                same = same and found.weight[point, c] == old_set.weight[old, c]
            if same:
                pressed[1, point] = pressed[0, old]
                copy(held[0, old], held[1, point])
                break
    copy(pressed[1, :points], pressed[0, :points])
    copy(held[1, :points], held[0, :points])


@kernel
def reset_state(model: Model, state: State) -> None:
    """Return to the rest shape, asleep, without tools; the counters continue.

    Parameters
    ----------
    model : Model
        Constants of the model.
    state : State
        State of the simulation; updated.
    """
    status = state.status
    status.snapped = status.collapsing = status.faulted = False
    status.fault_kind = status.substeps = status.quiet = status.alone = status.calm = 0
    status.touching = status.active = status.loaded = status.turned = status.next_cell = 0
    status.good_age = status.shown = status.oscillating = status.halving = 0
    status.turning = 0.0
    status.asleep = True
    status.backoff = 1
    state.contacts.header.points = state.contacts.header.sequence = 0
    copy(model.rest, state.position)
    copy(model.rest, state.good_position)
    state.velocity[:] = 0.0
    state.nodal_force[:] = 0.0
    state.is_loaded[:] = 0
    forget_prescribed(state)
    state.is_turned[:] = 0
    state.contact_pressed[:] = 0.0
    state.contact_held[:] = 0.0
    forget_blades(state)
    for number in range(len(state.blades)):
        state.blades[number].area = 0.0  # the organ is whole again
    drop_region(state)
    forget_relaxation(state)
    state.body_goal[:] = 0.0
    state.body_goal[:, 6] = 1.0
    copy(state.body_goal, state.held_pose)
    copy(state.body_goal, state.body_pose)
    state.body_force[:] = 0.0
    state.carried[:] = 0.0
    state.wrench[:] = 0.0
    state.unfaded_wrench[:] = 0.0
    for body in range(len(state.bodies)):
        status = state.bodies[body]
        if status.pose_sequence > 0:
            status.releases += 1
        status.age = status.force_age = -1
        status.stamp = status.pose_sequence = status.force_sequence = 0
        status.remaining = status.speed = status.turning = status.recent_speed = 0.0
        forget_slips(status)
        status.engaged = status.held_off = status.released = status.resisted = status.placed = False
        state.contacts.engaged[body] = Engaged.NO.value
        for c in range(POINT_NODES):
            state.contacts.tip_node[body, c] = -1
