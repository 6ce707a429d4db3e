"""Local region (section 4 of the paper): nodes within some layers of the load move by their springs or cells.

In the paper's own kind, the rest of the organ doesn't move; with modal_region it responds as the whole organ would.
The cost of all functions here depends on the size of the region, not on that of the organ.
"""

from __future__ import annotations

from typing import Any

from tissue_sim.array_types import Floats, Ints, Longs
from tissue_sim.handles import has
from tissue_sim.jit import chosen, kernel, part
from tissue_sim.model.data.arrays import copy
from tissue_sim.model.data.blocks import BLOCK, Blocks
from tissue_sim.model.data.contact_set import POINT_NODES, nodes_of
from tissue_sim.model.data.model import Model, Tissue
from tissue_sim.model.data.scratch import Scratch
from tissue_sim.model.data.state import State
from tissue_sim.model.elasticity.cells import cell_forces_among
from tissue_sim.model.elasticity.forces import edge_forces, return_forces, spring_forces

FROZEN_HOPS = 2  # the "second layer"; every spring counts as one hop
MODAL_HOPS = 1  # sufficient with a table of the compliance: a second layer changes equilibria by 0.2 %
UNTABLED_HOPS = 2  # with modes alone: on an organ of 4000 points, one layer gives errors of up to 20 %, two up to 7 %


@kernel
def mark_loaded(state: State, scratch: Scratch) -> int:
    """Set the hop distance 0 for the nodes of contact points, tool tips and nodal forces.

    Parameters
    ----------
    state : State
        State of the simulation; updated.
    scratch : Scratch
        Working memory; updated.

    Returns
    -------
    int
        Number of new nodes, which are in scratch.new_node.
    """
    fresh = 0
    for entry in range(state.contacts.header.points):
        if state.bodies[state.contacts.body[entry]].engaged:
            for c in range(nodes_of(state.contacts, entry)):
                fresh = _mark(state, scratch, state.contacts.node[entry, c], fresh)
    for body in range(len(state.body_force)):
        if state.contacts.tip_node[body, 0] >= 0:
            for c in range(POINT_NODES):
                fresh = _mark(state, scratch, state.contacts.tip_node[body, c], fresh)
    for index in range(state.status.loaded):
        fresh = _mark(state, scratch, state.loaded_node[index], fresh)
    return fresh


@kernel
def _mark(state: State, scratch: Scratch, node: int, fresh: int) -> int:
    """Set the hop distance 0 for a node; return the number of new nodes."""
    hop = state.region_hop
    if hop[node] == 0:
        return fresh
    scratch.previous_hop[fresh] = hop[node]
    scratch.new_node[fresh] = node
    hop[node] = 0
    return fresh + 1


@kernel
def spread(model: Model, state: State, scratch: Scratch, fresh: int, hops: int) -> None:
    """Add the new nodes and those within some hops of them to the region; from the table, or breadth first.

    Parameters
    ----------
    model : Model
        Constants of the model.
    state : State
        State of the simulation; updated.
    scratch : Scratch
        Working memory; updated.
    fresh : int
        Number of new nodes.
    hops : int
        Number of hops.
    """
    for index in range(fresh):
        if scratch.previous_hop[index] < 0:
            _join(state, scratch, scratch.new_node[index])
    if len(model.hops) > 0:
        for index in range(fresh):
            node = scratch.new_node[index]
            if node < model.n_surface:
                for other in range(model.n_surface):
                    if model.hops[node, other] <= hops:
                        _reach(state, scratch, other, model.hops[node, other])
        return
    first, last = 0, fresh
    for layer in range(1, hops + 1):
        for index in range(first, last):
            node = scratch.new_node[index]
            for entry in range(model.neighbour_start[node], model.neighbour_start[node + 1]):
                other = model.neighbours[entry]
                if _reach(state, scratch, other, layer):
                    scratch.new_node[fresh] = other
                    fresh += 1
        first, last = last, fresh


@kernel
def _reach(state: State, scratch: Scratch, node: int, hops: int) -> bool:
    """Set the hop distance of a node if it is shorter than before; return whether it is."""
    there = state.region_hop[node]
    if there < 0:
        _join(state, scratch, node)
    elif there <= hops:
        return False
    state.region_hop[node] = hops
    return True


@kernel
def _join(state: State, scratch: Scratch, node: int) -> None:
    """Append a node to the region's nodes; collect sorts them."""
    scratch.region_node[state.status.region_nodes] = node
    state.status.region_nodes += 1


@kernel
def list_drive(state: State, scratch: Scratch) -> None:
    """List the nodes of the region and those at its edge, in scratch.drive_node.

    Parameters
    ----------
    state : State
        State of the simulation; updated.
    scratch : Scratch
        Working memory; updated.
    """
    nodes, drive = state.status.region_nodes, driving(state, scratch)
    copy(scratch.region_node[:nodes], drive[:nodes])
    copy(scratch.boundary_node[: state.status.region_boundary], drive[nodes:])


@part
def driving(state: State, scratch: Scratch) -> Ints:
    """Return the nodes of the region and at its edge, as listed by list_drive.

    Parameters
    ----------
    state : State
        State of the simulation.
    scratch : Scratch
        Working memory.

    Returns
    -------
    Ints, shape (k,)
        Nodes.
    """
    return scratch.drive_node[: state.status.region_nodes + state.status.region_boundary]


@kernel
def list_nodes(state: State, scratch: Scratch) -> None:
    """List the region's nodes again, from the hop distances alone.

    Parameters
    ----------
    state : State
        State of the simulation; updated.
    scratch : Scratch
        Working memory; updated.
    """
    state.status.region_nodes = 0
    for node in range(len(state.region_hop)):
        if state.region_hop[node] >= 0:
            _join(state, scratch, node)


@kernel
def collect(model: Model, state: State, scratch: Scratch) -> None:
    """List the springs or cells of the region's nodes, and the nodes at its edge that these use.

    The order is that of the nodes' indices, so that lists that are made again are the same.

    Parameters
    ----------
    model : Model
        Constants of the model.
    state : State
        State of the simulation; updated.
    scratch : Scratch
        Working memory; updated.
    """
    nodes = state.status.region_nodes
    region = scratch.region_node
    for index in range(1, nodes):
        node, place = region[index], index
        while place > 0 and region[place - 1] > node:
            region[place] = region[place - 1]
            place -= 1
        region[place] = node
    scratch.stamp[0] += 1
    moved = 0
    for index in range(nodes):
        node = region[index]
        scratch.node_mark[node] = scratch.stamp[0]
        if model.inverse_mass[node] > 0.0:
            scratch.moved_node[moved] = node
            moved += 1
    scratch.n_moved[0] = moved
    collect_elements(model, state, scratch)


@kernel
def _collect_springs(model: Model, state: State, scratch: Scratch) -> None:
    springs = hinges = 0
    adjacency: Any = model.adjacency
    stamp = scratch.stamp[0]
    for index in range(state.status.region_nodes):
        node = scratch.region_node[index]
        slots = adjacency.edges[adjacency.edge_start[node] : adjacency.edge_start[node + 1]]
        source, target = (model.edges, model.reduction.edge_slopes), (scratch.edges, scratch.edge_slopes)
        hinges = _take(slots, source, target, scratch.edge_mark, stamp, hinges)
        slots = adjacency.links[adjacency.link_start[node] : adjacency.link_start[node + 1]]
        source, target = (model.links, model.reduction.link_slopes), (scratch.links, scratch.link_slopes)
        springs = _take(slots, source, target, scratch.link_mark, stamp, springs)
    boundary = _list_boundary(scratch, scratch.edges.nodes, hinges, stamp, 0)
    boundary = _list_boundary(scratch, scratch.links.nodes, springs, stamp, boundary)
    _fill_up(scratch.edges, hinges, 7, 4)
    _fill_up(scratch.links, springs, 1, 1)
    _blank_rows(scratch.edge_slopes, hinges)
    _blank_rows(scratch.link_slopes, springs)
    state.status.region_boundary = boundary
    state.status.region_springs = springs
    state.status.region_hinges = hinges


@kernel
def _collect_cells(model: Model, state: State, scratch: Scratch) -> None:
    cells = 0
    adjacency: Any = model.adjacency
    stamp = scratch.stamp[0]
    for index in range(state.status.region_nodes):
        node = scratch.region_node[index]
        slots = adjacency.cells[adjacency.cell_start[node] : adjacency.cell_start[node + 1]]
        source, target = (model.tissue, model.reduction.cell_slopes), (scratch.cells, scratch.cell_slopes)
        cells = _take(slots, source, target, scratch.cell_mark, stamp, cells)
    state.status.region_boundary = _list_boundary(scratch, scratch.cells.nodes, cells, stamp, 0)
    # The padding has the volume of the first cell, so that it doesn't count as compressed.
    _fill_up(scratch.cells, cells, 7, 8)
    for row in range(cells % BLOCK, BLOCK if cells % BLOCK > 0 else 0):
        for k in (0, 1, 2, 3, 4, 5, 9):
            scratch.cells.constants[cells // BLOCK, k * BLOCK + row] = 0.0
    _blank_rows(scratch.cell_slopes, cells)
    state.status.region_cells = cells


@chosen(lambda model, *_: _collect_cells if has(model, "tissue") else _collect_springs)
def collect_elements(model: Model, state: State, scratch: Scratch) -> None:
    """List the springs or cells of the region's nodes, which are marked, and the nodes at its edge."""


@kernel
def _take(
    slots: Ints,
    source: tuple[Blocks | Tissue, Floats],
    target: tuple[Blocks, Floats],
    mark: Longs,
    stamp: int,
    count: int,
) -> int:
    """Append the unmarked contents of slots after the first `count`; return the new count.

    source, target: blocks, and their rows of slopes.
    """
    for entry in range(len(slots)):
        slot = slots[entry]
        if mark[slot] != stamp:
            mark[slot] = stamp
            _copy(source[0], slot, target[0], count)
            _copy_rows(source[1], slot, target[1], count)
            count += 1
    return count


@kernel
def _copy(source: Blocks | Tissue, slot: int, target: Blocks, place: int) -> None:
    """Copy a spring from one set of blocks to another."""
    block, row = slot // BLOCK, slot % BLOCK
    to, at = place // BLOCK, place % BLOCK
    for c in range(source.nodes.shape[2]):
        target.nodes[to, at, c] = source.nodes[block, row, c]
    _copy_rows(source.constants, slot, target.constants, place)


@kernel
def _copy_rows(source: Floats, slot: int, target: Floats, place: int) -> None:
    """Copy the constants of a spring from blocks (b, k BLOCK) to others; without blocks, copy nothing."""
    if len(source) == 0:
        return
    block, row = slot // BLOCK, slot % BLOCK
    to, at = place // BLOCK, place % BLOCK
    for k in range(source.shape[1] // BLOCK):
        target[to, k * BLOCK + at] = source[block, k * BLOCK + row]


@kernel
def _fill_up(blocks: Blocks, count: int, axial: int, angular: int) -> None:
    """Fill the last block with copies of its first spring that have no stiffness, in rows axial and angular."""
    if count % BLOCK == 0:
        return
    block = count // BLOCK
    for row in range(count % BLOCK, BLOCK):
        for c in range(blocks.nodes.shape[2]):
            blocks.nodes[block, row, c] = blocks.nodes[block, 0, c]
        for k in range(blocks.constants.shape[1] // BLOCK):
            blocks.constants[block, k * BLOCK + row] = blocks.constants[block, k * BLOCK]
        blocks.constants[block, axial * BLOCK + row] = 0.0
        blocks.constants[block, angular * BLOCK + row] = 0.0


@kernel
def _blank_rows(rows: Floats, count: int) -> None:
    """Zero the constants of the springs that fill the last block."""
    if len(rows) > 0 and count % BLOCK > 0:
        for row in range(count % BLOCK, BLOCK):
            for k in range(rows.shape[1] // BLOCK):
                rows[count // BLOCK, k * BLOCK + row] = 0.0


@kernel
def _list_boundary(scratch: Scratch, nodes: Ints, count: int, stamp: int, boundary: int) -> int:
    """Append unmarked nodes of `count` springs to scratch.boundary_node; return how many there are."""
    for s in range(count):
        for c in range(nodes.shape[2]):
            node = nodes[s // BLOCK, s % BLOCK, c]
            if scratch.node_mark[node] != stamp:
                scratch.node_mark[node] = stamp
                scratch.boundary_node[boundary] = node
                boundary += 1
    return boundary


@kernel
def clear_force(state: State, scratch: Scratch) -> None:
    """Set scratch.force to zero where the region's springs add to it.

    Parameters
    ----------
    state : State
        State of the simulation.
    scratch : Scratch
        Working memory; updated.
    """
    scale_nodes(scratch.force, scratch.region_node[: state.status.region_nodes], 0.0)
    scale_nodes(scratch.force, scratch.boundary_node[: state.status.region_boundary], 0.0)


@kernel
def scale_force(state: State, scratch: Scratch, scale: float) -> None:
    """Multiply the forces that clear_force sets to zero.

    Parameters
    ----------
    state : State
        State of the simulation.
    scratch : Scratch
        Working memory; updated.
    scale : float
        The factor.
    """
    if scale != 1.0:
        scale_nodes(scratch.force, scratch.region_node[: state.status.region_nodes], scale)
        scale_nodes(scratch.force, scratch.boundary_node[: state.status.region_boundary], scale)


@kernel
def scale_nodes(values: Floats, nodes: Ints, scale: float) -> None:
    """Multiply values of some nodes; a scale of 0 sets them to zero, even if they are not finite.

    Parameters
    ----------
    values : Floats, shape (n, 3)
        Values, updated.
    nodes : Ints, shape (k,)
        Nodes.
    scale : float
        The factor.
    """
    for index in range(len(nodes)):
        node = nodes[index]
        for c in range(3):
            values[node, c] = scale * values[node, c] if scale != 0.0 else 0.0


@kernel
def _spring_forces(model: Model, state: State, scratch: Scratch) -> None:
    hinges, springs = -(-state.status.region_hinges // BLOCK), -(-state.status.region_springs // BLOCK)
    edges, links, work, force = scratch.edges, scratch.links, scratch.work, scratch.force
    edge_forces(state.position, edges.nodes[:hinges], edges.constants[:hinges], work, force)
    spring_forces(state.position, links.nodes[:springs], links.constants[:springs], work, force)


@kernel
def _cell_forces(model: Model, state: State, scratch: Scratch) -> None:
    nodes, blocks = driving(state, scratch), -(-state.status.region_cells // BLOCK)
    cells = scratch.cells
    cell_forces_among(
        state.position, nodes, cells.nodes[:blocks], cells.constants, model.tissue, scratch.work, scratch.force
    )


@chosen(lambda model, *_: _cell_forces if has(model, "tissue") else _spring_forces)
def region_forces(model: Model, state: State, scratch: Scratch) -> None:
    """Add the forces of the region's springs, without return springs, or cells to scratch.force (n, 3) N.

    Parameters
    ----------
    model : Model
        Constants of the model.
    state : State
        State of the simulation; updated.
    scratch : Scratch
        Working memory; updated.
    """


@kernel
def _return_forces(model: Model, state: State, scratch: Scratch) -> None:
    nodes = scratch.moved_node[: scratch.n_moved[0]]
    return_forces(state.position, model.rest, nodes, model.return_stiffness, scratch.force)


@kernel
def _no_return_forces(model: Model, state: State, scratch: Scratch) -> None:
    """Do nothing: cells have no return springs."""


@chosen(lambda model, *_: _no_return_forces if has(model, "tissue") else _return_forces)
def region_return_forces(model: Model, state: State, scratch: Scratch) -> None:
    """Add the forces of the return springs of the region's nodes to scratch.force (n, 3) N.

    Parameters
    ----------
    model : Model
        Constants of the model.
    state : State
        State of the simulation; updated.
    scratch : Scratch
        Working memory; updated.
    """
