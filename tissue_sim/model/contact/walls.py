"""Walls: fixed tissue, out of which the tool is moved, since the tissue can't move; what that takes is a force."""

from __future__ import annotations

import math

from tissue_sim.jit import kernel
from tissue_sim.model.contact.gap import gap_and_normal, is_on_outer_side, point_in_body
from tissue_sim.model.contact.impulses import count_on_body
from tissue_sim.model.contact.poses import distance_along_path, set_frame
from tissue_sim.model.contact.shapes import signed_distance
from tissue_sim.model.data.arrays import copy
from tissue_sim.model.data.contact_set import nodes_of
from tissue_sim.model.data.model import Model
from tissue_sim.model.data.scratch import Scratch
from tissue_sim.model.data.shapes import Shapes
from tissue_sim.model.data.state import State

WALL = 0.5  # largest depth of a body in fixed tissue, relative to its finest feature, so its middle stays outside
MOVES = 0.5  # fraction of a contact point's weights on moving nodes, below which it counts as fixed
STIFFNESS = 500.0  # N/m between the hand and a rigid tool that a wall holds back; a coupled tool has its spring
STEEPEST = 2.0  # bound on the slope of a distance: 1, and the root of 3 where it is interpolated on a grid


@kernel
def find_walls(model: Model, state: State, scratch: Scratch) -> None:
    """List the contact points on mostly fixed nodes in scratch.wall: they hardly yield to a tool.

    Parameters
    ----------
    model : Model
        Constants of the model.
    state : State
        State of the simulation.
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
            scratch.wall[count], scratch.wall_depth[count] = entry, 0.0 if moves == 0.0 else math.inf
            count += 1
    scratch.n_walls[0], scratch.walls_measured[0] = count, 0


@kernel
def leave_wall(state: State, shapes: Shapes, scratch: Scratch) -> bool:
    """Move a tool out of the fixed point that lies deepest in it; return False if none lies deeper than WALL.

    A tool pushes moving tissue forward; into fixed tissue it would move on until it has slipped inside.
    """
    if scratch.walls_measured[0] == 0:
        measure_walls(state, shapes, scratch)
    deepest, chosen, body, moved = 0.0, -1, -1, 0.0
    x = y = z = px = py = pz = 0.0
    for index in range(scratch.n_walls[0]):
        entry = scratch.wall[index]
        if body != state.contacts.body[entry]:
            body = state.contacts.body[entry]
            set_frame(state.body_pose[body], scratch.origin[body], scratch.rotation[body])
            before, now = scratch.wall_pose[body], state.body_pose[body]
            moved = STEEPEST * distance_along_path(before, now, shapes.extent[body])
        if scratch.wall_depth[index] + moved < 0.0:
            continue
        deep = depth_of_wall(state, shapes, scratch, entry)
        if deep > deepest:  # rare; the normal is only computed here
            ox, oy, oz, lx, ly, lz = point_in_body(state, entry, scratch.origin, scratch.rotation)
            _, nx, ny, nz = gap_and_normal(shapes, body, scratch.rotation[body], lx, ly, lz)
            if is_on_outer_side(state, entry, (nx, ny, nz)):
                deepest, chosen, x, y, z = deep, body, nx, ny, nz
                px, py, pz = ox, oy, oz
    if chosen < 0:
        return False
    push, arm, origin = scratch.wall_push[chosen], scratch.wall_arm[chosen], scratch.origin[chosen]
    push[0], push[1], push[2] = push[0] + deepest * x, push[1] + deepest * y, push[2] + deepest * z
    arm[0], arm[1], arm[2] = px - origin[0], py - origin[1], pz - origin[2]
    for body in range(len(state.body_pose)):
        if shapes.tool[body] == shapes.tool[chosen]:
            pose = state.body_pose[body]
            pose[0], pose[1], pose[2] = pose[0] - deepest * x, pose[1] - deepest * y, pose[2] - deepest * z
    return True


@kernel
def press_walls(state: State, scratch: Scratch, step: float) -> None:
    """Add the impulses with which tools press on the walls that have moved them in this substep to scratch.impulse.

    A coupled tool was moved by its spring and its damper, and a wall has undone that. A rigid one has a spring of
    STIFFNESS, of which the wall takes what the tissue doesn't.

    Parameters
    ----------
    state : State
        State of the simulation.
    scratch : Scratch
        Working memory, with the impulses of this substep on the tissue; updated.
    step : float, s
        The substep.
    """
    for body in range(len(state.body_pose)):
        push = scratch.wall_push[body]
        way = math.sqrt(push[0] * push[0] + push[1] * push[1] + push[2] * push[2])
        if way == 0.0:
            continue
        x, y, z = push[0] / way, push[1] / way, push[2] / way
        if scratch.give[body] > 0.0:
            size = way / scratch.give[body]
        else:
            before, now, held, pose = (
                scratch.wall_before[body],
                scratch.impulse[body],
                scratch.held[body],
                state.body_pose[body],
            )
            taken = x * (now[0] - before[0]) + y * (now[1] - before[1]) + z * (now[2] - before[2])
            beyond = x * (held[0] - pose[0]) + y * (held[1] - pose[1]) + z * (held[2] - pose[2])
            size = max(0.0, STIFFNESS * step * beyond - max(0.0, taken))
        count_on_body(scratch, body, scratch.wall_arm[body], (size * x, size * y, size * z))


@kernel
def measure_walls(state: State, shapes: Shapes, scratch: Scratch) -> None:
    """Write the depth of each fixed point in its tool; until the tool has moved as far, it needn't be examined again.

    Points that are partly on moving nodes are always examined.
    """
    body = -1
    for index in range(scratch.n_walls[0]):
        entry = scratch.wall[index]
        if body != state.contacts.body[entry]:
            body = state.contacts.body[entry]
            set_frame(state.body_pose[body], scratch.origin[body], scratch.rotation[body])
            copy(state.body_pose[body], scratch.wall_pose[body])
        if scratch.wall_depth[index] == 0.0:
            scratch.wall_depth[index] = depth_of_wall(state, shapes, scratch, entry)
    scratch.walls_measured[0] = 1


@kernel
def depth_of_wall(state: State, shapes: Shapes, scratch: Scratch, entry: int) -> float:
    """Return the depth of a point in its tool, m, beyond WALL; the tool's frame has been set."""
    body = state.contacts.body[entry]
    _, _, _, lx, ly, lz = point_in_body(state, entry, scratch.origin, scratch.rotation)
    return -signed_distance(shapes, body, lx, ly, lz)[0] - WALL * shapes.finest[body]
