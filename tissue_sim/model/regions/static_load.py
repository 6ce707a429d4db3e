"""Static load of a modal region on the rest of the organ: its loads, and the nonlinear part of its forces."""

from __future__ import annotations

import math

from tissue_sim.array_types import Floats, Ints
from tissue_sim.handles import has
from tissue_sim.jit import chosen, kernel
from tissue_sim.model.contact.tool_motion import add_tip_forces
from tissue_sim.model.data.arrays import copy_nodes
from tissue_sim.model.data.blocks import BLOCK
from tissue_sim.model.data.model import Model
from tissue_sim.model.data.scratch import Scratch
from tissue_sim.model.data.settings import Settings
from tissue_sim.model.data.state import State
from tissue_sim.model.elasticity.cells import subtract_linear_cells
from tissue_sim.model.elasticity.forces import subtract_linear_edges, subtract_linear_springs
from tissue_sim.model.regions.local_region import driving, scale_nodes

LOAD_TIME = 0.005  # s in which the far field follows a changed load; faster, it would oscillate with a held tool


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
        scale_nodes(drive, nodes, scale)


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
    """Subtract the forces that the region would have if it were linear about rest from force (n, 3) N."""


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
        Fraction of the difference.
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
def _absorb(load: Floats, drive: Floats, impulse: Floats, nodes: Ints, rate: float, fraction: float) -> None:
    for index in range(len(nodes)):
        node = nodes[index]
        for c in range(3):
            wanted = drive[node, c] + impulse[node, c] * rate
            impulse[node, c] = 0.0
            load[node, c] += fraction * (wanted - load[node, c])


@kernel
def load_fraction(model: Model, settings: Settings) -> float:
    """Return the fraction of the difference by which the static load approaches the present load in a tick.

    The part of the response without modes follows no faster than the slow rate of the fastest mode, if damping makes
    that slow: the surroundings in a soft organ would otherwise move ahead of the region, and supply energy to it.

    Parameters
    ----------
    model : Model
        Constants of the model.
    settings : Settings
        Settings of the simulation.
    """
    frequency, seconds = model.reduction.frequency, LOAD_TIME
    if len(frequency) > 0:
        square = settings.stiffness_scale * frequency[len(frequency) - 1] ** 2
        seconds = max(seconds, settings.damping_scale * model.damping_rate / square)
    return 1.0 - math.exp(-settings.tick_time / seconds)
