"""Modal local region: nonlinear springs or cells around the load, the rest of the organ as a linear body.

Freezing the rest of the organ is wrong for a body that is loaded for longer than a few milliseconds. Here the nodes
around the load move by their own springs, as in the paper's region, and the nodes at its edge move as the rest of the
organ does: u = C p + F (q - q_s). C p is its static displacement under the load p, with C the compliance about rest;
the lowest modes F carry the motion, q their coordinates under p and q_s where these would come to rest. p holds the
loads, and the difference of the region's spring forces from linear ones: with these, a region of one layer settles
within 2 % of the whole nonlinear model under dents of 3 mm, while the loads alone give 7 %.

Without a table C (large organs) more modes replace it. Only rows that are needed are evaluated: the edge in each tick,
the whole organ on demand.
"""

from __future__ import annotations

import math
from typing import Any

from tissue_sim.array_types import Floats
from tissue_sim.handles import has
from tissue_sim.jit import chosen, kernel
from tissue_sim.model.contact.tool_motion import add_tip_forces
from tissue_sim.model.data.arrays import copy, copy_nodes
from tissue_sim.model.data.blocks import BLOCK
from tissue_sim.model.data.model import Model
from tissue_sim.model.data.scratch import Scratch
from tissue_sim.model.data.settings import Settings
from tissue_sim.model.data.state import State
from tissue_sim.model.elasticity.cells import subtract_linear_cells
from tissue_sim.model.elasticity.forces import subtract_linear_edges, subtract_linear_springs
from tissue_sim.model.regions import local_region
from tissue_sim.model.regions.local_region import driving

MOST_BOUNDARY = 256  # nodes at the edge of a region; one with more isn't local
MOST_DRIVE = 640  # nodes in the region and at its edge
LOAD_TIME = 0.005  # s in which the far field follows a changed load; if shorter, it would oscillate with a held tool
OFFSET_TIME = 0.25  # s in which an offset fades
FASTEST = 1.0  # rad per tick; faster modes would kick the region's edge, and follow the load without inertia instead


@kernel
def forget_region(state: State) -> None:
    """Remove the region and everything that it has left behind.

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

    Returns
    -------
    int
        The number.
    """
    return local_region.MODAL_HOPS if len(model.reduction.compliance) > 0 else local_region.UNTABLED_HOPS


@kernel
def fits(state: State) -> bool:
    """Return whether the region is small enough to be a local one.

    Parameters
    ----------
    state : State
        State of the simulation; updated.

    Returns
    -------
    bool
        True where it is.
    """
    boundary = state.status.region_boundary
    return boundary <= MOST_BOUNDARY and state.status.region_nodes + boundary <= MOST_DRIVE


@kernel
def gather_rows(model: Model, state: State, scratch: Scratch) -> None:
    """Copy what the edge of the region needs: rows of C for each load and of F for each mode, and F at the loads.

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
def _copy_modes(shape: Any, drive: Any, boundary: Any, drive_rows: Any, edge_rows: Any) -> None:
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
def _copy_compliance(table: Any, drive: Any, boundary: Any, rows: Any) -> None:
    for j in range(len(drive)):
        for a in range(3):
            source, target = table[3 * drive[j] + a], rows[3 * j + a]
            for b in range(len(boundary)):
                first = 3 * boundary[b]
                target[3 * b] = source[first]
                target[3 * b + 1] = source[first + 1]
                target[3 * b + 2] = source[first + 2]


@kernel
def combine(rows: Any, factors: Any, count: int, total: Any) -> None:
    """Compute total (r,) as the sum of the first `count` rows (.., r), each times its factor; in single precision."""
    total[:] = 0.0
    for i in range(0, count - 3, 4):
        w, x, y, z = factors[i], factors[i + 1], factors[i + 2], factors[i + 3]
        a, b, c, d = rows[i], rows[i + 1], rows[i + 2], rows[i + 3]
        for r in range(len(total)):
            total[r] += (w * a[r] + x * b[r]) + (y * c[r] + z * d[r])
    for i in range(count - count % 4, count):
        w, a = factors[i], rows[i]
        for r in range(len(total)):
            total[r] += w * a[r]


@kernel
def set_propagator(model: Model, settings: Settings, scratch: Scratch) -> None:
    """Compute the exact motion of every mode in a tick when settings have changed: q'' + c q' + w^2 q = p.

    Parameters
    ----------
    model : Model
        Constants of the model.
    settings : Settings
        Settings of the simulation.
    scratch : Scratch
        Working memory; updated.
    """
    key = scratch.propagator_key
    tick_time, scale, damping = settings.tick_time, settings.stiffness_scale, settings.damping_scale
    if key[0] == tick_time and key[1] == scale and key[2] == damping:
        return
    key[0], key[1], key[2] = tick_time, scale, damping
    half = 0.5 * damping * model.damping_rate
    for k in range(len(model.reduction.frequency)):
        square = scale * model.reduction.frequency[k] ** 2
        decay = math.exp(-half * tick_time)
        bend = square - half * half
        if bend > 1e-9 * square:
            turn = math.sqrt(bend)
            cosine, sine = math.cos(turn * tick_time), math.sin(turn * tick_time) / turn
        elif bend < -1e-9 * square:
            turn = math.sqrt(-bend)
            cosine, sine = math.cosh(turn * tick_time), math.sinh(turn * tick_time) / turn
        else:
            cosine, sine = 1.0, tick_time
        scratch.propagator[0, k] = 1.0 / square
        if square * tick_time * tick_time > FASTEST * FASTEST:
            for row in range(1, 5):
                scratch.propagator[row, k] = 0.0
            continue
        scratch.propagator[1, k] = decay * (cosine + half * sine)
        scratch.propagator[2, k] = decay * sine
        scratch.propagator[3, k] = decay * (cosine - half * sine)
        scratch.propagator[4, k] = -decay * square * sine


@kernel
def project_load(state: State, scratch: Scratch) -> None:
    """Compute the static displacement of the modes into scratch.mode_rest, and the loads into edge_load.

    Parameters
    ----------
    state : State
        State of the simulation; updated.
    scratch : Scratch
        Working memory; updated.
    """
    nodes = driving(state, scratch)
    load, driving_load, rest = state.static_load, scratch.edge_load, scratch.mode_rest
    for index in range(len(nodes)):
        for c in range(3):
            driving_load[3 * index + c] = load[nodes[index], c]
    combine(scratch.drive_rows, driving_load, 3 * len(nodes), scratch.mode_sum)
    total, inverse = scratch.mode_sum, scratch.propagator[0]
    for k in range(len(rest)):
        rest[k] = inverse[k] * total[k]


@kernel
def advance_modes(model: Model, state: State, settings: Settings, scratch: Scratch) -> None:
    """Step every mode exactly through a tick under the static load, and set scratch.mode_move.

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
    table = scratch.propagator
    for k in range(len(model.reduction.frequency)):
        rest = scratch.mode_rest[k]
        offset, speed = state.mode_position[k] - rest, state.mode_velocity[k]
        state.mode_position[k] = rest + table[1, k] * offset + table[2, k] * speed
        state.mode_velocity[k] = table[3, k] * speed + table[4, k] * offset
    set_mode_move(model, state, scratch)
    state.blend[0] *= math.exp(-settings.tick_time / OFFSET_TIME)


@kernel
def set_mode_move(model: Model, state: State, scratch: Scratch) -> None:
    """Compute what the modes add to the static displacement; without a compliance table that is all of it.

    Parameters
    ----------
    model : Model
        Constants of the model.
    state : State
        State of the simulation; updated.
    scratch : Scratch
        Working memory; updated.
    """
    held = 1.0 if len(model.reduction.compliance) > 0 else 0.0  # by the compliance table
    position, rest, move = state.mode_position, scratch.mode_rest, scratch.mode_move
    for k in range(len(move)):
        move[k] = position[k] - held * rest[k]


@kernel
def add_rows(total: Any, first: Any, second: Any, third: Any, load: Any, scale: float) -> None:
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
    """Put nodes that just joined the region where the old region's load moves them.

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
    """Put every node outside the region where it belongs, moving as the modes do; fill scratch.field (3n,) m.

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
def measure_drive(model: Model, state: State, settings: Settings, scratch: Scratch) -> None:
    """Compute the difference of the region's forces from linear ones into scratch.drive (n, 3) N.

    scratch.force holds the present forces.

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
    drive, nodes = scratch.drive, driving(state, scratch)
    copy_nodes(scratch.force, drive, nodes)
    subtract_linear(model, state, scratch, drive)
    scale = settings.stiffness_scale
    if scale != 1.0:
        local_region.scale_nodes(drive, nodes, scale)


@kernel
def _subtract_springs(model: Model, state: State, scratch: Scratch, force: Floats) -> None:
    hinges, springs = -(-state.status.region_hinges // BLOCK), -(-state.status.region_springs // BLOCK)
    subtract_linear_edges(state.position, scratch.edges.nodes[:hinges], scratch.edge_slopes, scratch.work, force)
    subtract_linear_springs(state.position, scratch.links.nodes[:springs], scratch.link_slopes, scratch.work, force)


@kernel
def _subtract_cells(model: Model, state: State, scratch: Scratch, force: Floats) -> None:
    nodes, blocks = driving(state, scratch), -(-state.status.region_cells // BLOCK)
    cells, slopes = scratch.cells.nodes[:blocks], scratch.cell_slopes
    subtract_linear_cells(state.position, nodes, cells, slopes, model.tissue, scratch.work, force)


@chosen(lambda model, *_: _subtract_cells if has(model, "tissue") else _subtract_springs)
def subtract_linear(model: Model, state: State, scratch: Scratch, force: Floats) -> None:
    """Subtract the region's forces if it were linear about rest from force (n, 3) N."""


@kernel
def absorb_load(state: State, settings: Settings, scratch: Scratch, fraction: float) -> None:
    """Move the static load towards this tick's loads and scratch.drive.

    Parameters
    ----------
    state : State
        State of the simulation; updated.
    settings : Settings
        Settings of the simulation.
    scratch : Scratch
        Working memory; updated.
    fraction : float
        Fraction of the way.
    """
    drive, nodal, loaded = scratch.drive, state.nodal_force, state.loaded_node
    for index in range(state.status.loaded):
        node = loaded[index]
        for c in range(3):
            drive[node, c] += nodal[node, c]
    add_tip_forces(state, settings, drive)
    nodes = driving(state, scratch)
    _absorb(state.static_load, drive, state.contact_impulse, nodes, 1.0 / settings.tick_time, fraction)


@kernel
def _absorb(load: Any, drive: Any, impulse: Any, nodes: Any, rate: float, fraction: float) -> None:
    for index in range(len(nodes)):
        node = nodes[index]
        for c in range(3):
            wanted = drive[node, c] + impulse[node, c] * rate
            impulse[node, c] = 0.0
            load[node, c] += fraction * (wanted - load[node, c])


@kernel
def load_fraction(model: Model, settings: Settings) -> float:
    """Return the fraction of the way that the static load moves in a tick.

    What the modes don't carry follows no faster than the slow rate of the fastest mode, if damping makes that slow: a
    soft organ's surroundings would otherwise move ahead of the region, and pull energy into it.

    Parameters
    ----------
    model : Model
        Constants of the model.
    settings : Settings
        Settings of the simulation.

    Returns
    -------
    float
        The fraction.
    """
    frequency, seconds = model.reduction.frequency, LOAD_TIME
    if len(frequency) > 0:
        square = settings.stiffness_scale * frequency[len(frequency) - 1] ** 2
        seconds = max(seconds, settings.damping_scale * model.damping_rate / square)
    return 1.0 - math.exp(-settings.tick_time / seconds)


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
            position = state.offset[node, c]  # kept there while place_outside ran
            state.position[node, c] = position
            state.offset[node, c] = position - model.rest[node, c] - scratch.field[3 * node + c]
    state.blend[0] = 1.0
