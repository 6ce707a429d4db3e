"""Nodes that a tick moves and places, in the whole organ or in a local region, and their distance from rest."""

from __future__ import annotations

from typing import Any

from tissue_sim.array_types import Ints, Longs
from tissue_sim.handles import has
from tissue_sim.jit import chosen, kernel, part
from tissue_sim.model.data.model import Model
from tissue_sim.model.data.scratch import Scratch
from tissue_sim.model.data.state import Region, State
from tissue_sim.model.regions.local_region import driving
from tissue_sim.model.regions.mode_motion import largest_modal_motion


@part
def integrated_nodes(model: Model, state: State, scratch: Scratch) -> Ints:
    """Return the nodes that a tick integrates.

    Parameters
    ----------
    model : Model
        Constants of the model.
    state : State
        State of the simulation.
    scratch : Scratch
        Working memory.

    Returns
    -------
    Ints, shape (k,)
        Nodes.
    """
    return model.moving if state.status.region == Region.WHOLE else scratch.moved_node[: scratch.n_moved[0]]


@part
def checked_nodes(model: Model, state: State, scratch: Scratch) -> Ints:
    """Return the nodes that a tick moves or places.

    Parameters
    ----------
    model : Model
        Constants of the model.
    state : State
        State of the simulation.
    scratch : Scratch
        Working memory.

    Returns
    -------
    Ints, shape (k,)
        Nodes.
    """
    if state.status.region == Region.WHOLE:
        return model.moving
    if state.status.region == Region.MODAL:
        return driving(state, scratch)
    return scratch.region_node[: state.status.region_nodes]


@kernel
def _are_moved(model: Model, state: State, scratch: Scratch, nodes: Longs | Ints) -> bool:
    mark, stamp = scratch.node_mark, scratch.stamp[0]
    listed = True
    for corner in range(len(nodes)):
        listed = listed and mark[nodes[corner]] == stamp
    return listed or state.status.region != Region.MODAL


@kernel
def _always(model: Model, state: State, scratch: Scratch, nodes: Longs | Ints) -> bool:
    return True


@chosen(lambda model, *_: _are_moved if has(model, "adjacency") else _always)
def are_placed(model: Model, state: State, scratch: Scratch, nodes: Longs | Ints) -> Any:
    """Return whether positions of nodes are those of this tick; outside a modal region they may be old.

    Parameters
    ----------
    model : Model
        Constants of the model.
    state : State
        State of the simulation; updated.
    scratch : Scratch
        Working memory; updated.
    nodes : Longs | Ints, shape (k,)
        The nodes.
    """


@kernel
def largest_motion(model: Model, state: State, scratch: Scratch) -> tuple[float, float]:
    """Return the largest components of velocity and of displacement from rest of the nodes.

    Parameters
    ----------
    model : Model
        Constants of the model.
    state : State
        State of the simulation.
    scratch : Scratch
        Working memory.

    Returns
    -------
    tuple[float, float]
        Velocity, m/s, and displacement, m.
    """
    speed_x = speed_y = speed_z = away_x = away_y = away_z = 0.0
    position, velocity, rest = state.position, state.velocity, model.rest
    nodes = scratch.region_node[: state.status.region_nodes] if state.status.region == Region.MODAL else model.moving
    for index in range(len(nodes)):
        node = nodes[index]
        speed_x = max(speed_x, abs(velocity[node, 0]))
        speed_y = max(speed_y, abs(velocity[node, 1]))
        speed_z = max(speed_z, abs(velocity[node, 2]))
        if len(model.free) > 0 and model.free[node] != 0:  # a piece that was cut off has no place to return to
            continue
        away_x = max(away_x, abs(position[node, 0] - rest[node, 0]))
        away_y = max(away_y, abs(position[node, 1] - rest[node, 1]))
        away_z = max(away_z, abs(position[node, 2] - rest[node, 2]))
    swing_speed, swing = largest_modal_motion(model, state)
    return max(speed_x, speed_y, speed_z, swing_speed), max(away_x, away_y, away_z, swing)
