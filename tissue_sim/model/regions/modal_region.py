"""Modal local region: nonlinear springs or cells around the load, the rest of the organ as a linear body.

Freezing the rest of the organ is wrong for a body that is loaded for longer than a few milliseconds. Here the nodes
around the load move by their own springs, as in the paper's region, and the nodes at its edge move as the rest of the
organ does: u = C p + F (q - q_s). C p is its static displacement under the load p, with C the compliance about rest;
F are the lowest modes, which represent the motion, q their coordinates under p, and q_s those at rest under p. p
consists of the loads and the difference of the region's spring forces from linear ones: with the latter, a region of
one layer settles within 2 % of the whole nonlinear model under dents of 3 mm, and within 7 % without them.

For large organs, without a table of C, more modes replace it. Only rows that are needed are evaluated: those of the
edge in each tick, those of the whole organ on demand.
"""

from __future__ import annotations

from tissue_sim.array_types import Floats, Ints, Singles
from tissue_sim.jit import kernel
from tissue_sim.model.data.arrays import copy
from tissue_sim.model.data.model import Model
from tissue_sim.model.data.scratch import Scratch
from tissue_sim.model.data.settings import Settings
from tissue_sim.model.data.state import State
from tissue_sim.model.regions import local_region
from tissue_sim.model.regions.local_region import driving
from tissue_sim.model.regions.mode_motion import combine, project_load, set_mode_move, set_propagator

MAX_BOUNDARY = 256  # nodes at the edge of a region; one with more isn't local
MAX_DRIVE = 640  # nodes in the region and at its edge


@kernel
def forget_region(state: State) -> None:
    """Remove the region and its loads, modes and offset.

    Parameters
    ----------
    state : State
        State of the simulation; updated.
    """
    state.region_hop[:] = -1
    state.status.region_nodes = state.status.region_boundary = 0
    state.status.region_springs = state.status.region_hinges = state.status.region_cells = 0
    state.contact_impulse[:] = 0.0
    state.static_load[:] = 0.0
    state.offset[:] = 0.0
    state.blend[0] = 0.0
    state.mode_position[:] = 0.0
    state.mode_velocity[:] = 0.0


@kernel
def hops_of(model: Model) -> int:
    """Return the number of layers around the load that move by themselves.

    Parameters
    ----------
    model : Model
        Constants of the model.
    """
    return local_region.MODAL_HOPS if len(model.reduction.compliance) > 0 else local_region.UNTABLED_HOPS


@kernel
def fits(state: State) -> bool:
    """Return whether the region is small enough for its buffers.

    Parameters
    ----------
    state : State
        State of the simulation.
    """
    boundary = state.status.region_boundary
    return boundary <= MAX_BOUNDARY and state.status.region_nodes + boundary <= MAX_DRIVE


@kernel
def gather_rows(model: Model, state: State, scratch: Scratch) -> None:
    """Copy the rows that the edge of the region needs: of C for each load, of F for each mode, and of F at the loads.

    Parameters
    ----------
    model : Model
        Constants of the model.
    state : State
        State of the simulation; updated.
    scratch : Scratch
        Working memory; updated.
    """
    boundary, drive = scratch.boundary_node[: state.status.region_boundary], driving(state, scratch)
    first = 0
    if len(model.reduction.compliance) > 0:
        _copy_compliance(model.reduction.compliance, drive, boundary, scratch.edge_rows)
        first = 3 * len(drive)
    _copy_modes(model.reduction.shape, drive, boundary, scratch.drive_rows, scratch.edge_rows[first:])


@kernel
def _copy_modes(shape: Floats, drive: Ints, boundary: Ints, drive_rows: Singles, edge_rows: Singles) -> None:
    for j in range(len(drive)):
        for c in range(3):
            source = shape[drive[j], c]
            for k in range(len(source)):
                drive_rows[3 * j + c, k] = source[k]
    for b in range(len(boundary)):
        for c in range(3):
            source = shape[boundary[b], c]
            for k in range(len(source)):
                edge_rows[k, 3 * b + c] = source[k]


@kernel
def _copy_compliance(table: Singles, drive: Ints, boundary: Ints, rows: Singles) -> None:
    for j in range(len(drive)):
        for a in range(3):
            source, target = table[3 * drive[j] + a], rows[3 * j + a]
            for b in range(len(boundary)):
                first = 3 * boundary[b]
                target[3 * b] = source[first]
                target[3 * b + 1] = source[first + 1]
                target[3 * b + 2] = source[first + 2]


@kernel
def add_rows(total: Floats, first: Singles, second: Singles, third: Singles, load: Floats, scale: float) -> None:
    """Add the effect of a load (3,) N on a node, from the three rows of its compliance, to total (r,) m."""
    x, y, z = scale * load[0], scale * load[1], scale * load[2]
    for r in range(len(total)):
        total[r] += x * first[r] + y * second[r] + z * third[r]


@kernel
def move_edge(model: Model, state: State, settings: Settings, scratch: Scratch) -> None:
    """Compute the displacements of the region's edge by the rest of the organ into scratch.edge_move (3b,) m.

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
    boundary = state.status.region_boundary
    load, move, columns = scratch.edge_load, scratch.mode_move, 0
    if len(model.reduction.compliance) > 0:
        columns = 3 * (state.status.region_nodes + boundary)
        for index in range(columns):
            load[index] /= settings.stiffness_scale
    for k in range(len(move)):
        load[columns + k] = move[k]
    combine(scratch.edge_rows, load, columns + len(move), scratch.edge_move[: 3 * boundary])


@kernel
def place_boundary(model: Model, state: State, settings: Settings, scratch: Scratch) -> None:
    """Put the nodes at the region's edge where the rest of the organ moves them.

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
    move_edge(model, state, settings, scratch)
    nodes, position, rest, offset = scratch.boundary_node, state.position, model.rest, state.offset
    moved, blend = scratch.edge_move, state.blend[0]
    for b in range(state.status.region_boundary):
        node = nodes[b]
        if model.inverse_mass[node] > 0.0:
            for c in range(3):
                position[node, c] = rest[node, c] + moved[3 * b + c] + blend * offset[node, c]


@kernel
def place_joined(model: Model, state: State, settings: Settings, scratch: Scratch, first: int) -> None:
    """Set nodes that have just joined the region to the positions to which the old region's load moves them.

    Parameters
    ----------
    model : Model
        Constants of the model.
    state : State
        State of the simulation; updated.
    settings : Settings
        Settings of the simulation.
    scratch : Scratch
        Working memory.
    first : int
        Index in region_node of the first of them.
    """
    reduction = model.reduction
    drive = state.status.region_boundary + first
    for index in range(first, state.status.region_nodes):
        node = scratch.region_node[index]
        if model.inverse_mass[node] == 0.0:
            continue
        for c in range(3):
            away, speed = state.blend[0] * state.offset[node, c], 0.0
            for k in range(len(reduction.frequency)):
                away += reduction.shape[node, c, k] * scratch.mode_move[k]
                speed += reduction.shape[node, c, k] * state.mode_velocity[k]
            if len(reduction.compliance) > 0:
                row = reduction.compliance[3 * node + c]
                for j in range(drive):
                    for a in range(3):
                        source = scratch.drive_node[j]
                        away += row[3 * source + a] * state.static_load[source, a] / settings.stiffness_scale
            state.position[node, c] = model.rest[node, c] + away
            state.velocity[node, c] = speed


@kernel
def place_outside(model: Model, state: State, settings: Settings, scratch: Scratch) -> None:
    """Compute positions and velocities of all nodes outside the region; write displacements to scratch.field (3n,) m.

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
    field, table = scratch.field, model.reduction.compliance
    field[:] = 0.0
    if len(table) > 0:
        load, scale, nodes = state.static_load, 1.0 / settings.stiffness_scale, driving(state, scratch)
        for index in range(len(nodes)):
            node = nodes[index]
            add_rows(field, table[3 * node], table[3 * node + 1], table[3 * node + 2], load[node], scale)
    position, velocity, offset = state.position, state.velocity, state.offset
    hop, rest, blend = state.region_hop, model.rest, state.blend[0]
    shapes, move, speed = model.reduction.shape, scratch.mode_move, state.mode_velocity
    for index in range(len(model.moving)):
        node = model.moving[index]
        shape = shapes[node]
        x, y, z = field[3 * node], field[3 * node + 1], field[3 * node + 2]
        u = v = w = 0.0
        for k in range(len(move)):
            x += shape[0, k] * move[k]
            y += shape[1, k] * move[k]
            z += shape[2, k] * move[k]
            u += shape[0, k] * speed[k]
            v += shape[1, k] * speed[k]
            w += shape[2, k] * speed[k]
        field[3 * node], field[3 * node + 1], field[3 * node + 2] = x, y, z
        if hop[node] < 0:
            position[node, 0] = rest[node, 0] + x + blend * offset[node, 0]
            position[node, 1] = rest[node, 1] + y + blend * offset[node, 1]
            position[node, 2] = rest[node, 2] + z + blend * offset[node, 2]
            velocity[node, 0], velocity[node, 1], velocity[node, 2] = u, v, w
    state.status.shown = state.status.tick


@kernel
def keep_offset(model: Model, state: State, settings: Settings, scratch: Scratch) -> None:
    """Start the modes at rest for a new region with its static load, and keep the remaining difference.

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
    set_propagator(model, settings, scratch)
    project_load(state, scratch)
    for k in range(len(model.reduction.frequency)):
        state.mode_position[k] = scratch.mode_rest[k]
        state.mode_velocity[k] = 0.0
    set_mode_move(model, state, scratch)
    state.blend[0] = 0.0
    copy(state.position, state.offset)
    place_outside(model, state, settings, scratch)
    for node in range(len(model.rest)):
        for c in range(3):
            position = state.offset[node, c]  # stored there while place_outside ran
            state.position[node, c] = position
            state.offset[node, c] = position - model.rest[node, c] - scratch.field[3 * node + c]
    state.blend[0] = 1.0
