"""Prescribed nodes: nodes with given positions, of which the reactions are computed."""

from __future__ import annotations

from tissue_sim.array_types import Floats, Longs
from tissue_sim.jit import kernel
from tissue_sim.model.data.model import Model
from tissue_sim.model.data.state import State


@kernel
def prescribe_nodes(state: State, nodes: Longs, positions: Floats, ticks: int) -> None:
    """Move nodes evenly to given positions from the next tick on, and hold them there.

    Parameters
    ----------
    state : State
        State of the simulation; updated.
    nodes : Longs, shape (k,)
        Nodes.
    positions : Floats, shape (k, 3), m
        Positions.
    ticks : int
        Number of ticks until they arrive.
    """
    status = state.status
    for index in range(len(nodes)):
        node = nodes[index]
        if state.is_prescribed[node] == 0:
            state.is_prescribed[node] = 1
            state.prescribed_node[status.prescribed] = node
            status.prescribed += 1
        state.prescribed_ticks[node] = ticks
        for axis in range(3):
            state.prescribed_from[node, axis] = state.position[node, axis]
            state.prescribed_to[node, axis] = positions[index, axis]
    status.prescriptions += 1


@kernel
def free_nodes(model: Model, state: State) -> None:
    """Release prescribed nodes with their present speed; the organ's fixed nodes stay where they are.

    Parameters
    ----------
    model : Model
        Constants of the model.
    state : State
        State of the simulation; updated.
    """
    status, left = state.status, 0
    for index in range(status.prescribed):
        node = state.prescribed_node[index]
        if model.inverse_mass[node] == 0.0:
            state.prescribed_node[left] = node
            left += 1
        else:
            state.is_prescribed[node] = 0
    status.prescribed = left
    status.prescriptions += 1


@kernel
def forget_prescribed(state: State) -> None:
    """Stop prescribing nodes.

    Parameters
    ----------
    state : State
        State of the simulation; updated.
    """
    state.is_prescribed[:] = 0
    state.status.prescribed = 0
    state.status.prescriptions += 1


@kernel
def move_prescribed(state: State, substep: int, substeps: int, step: float) -> None:
    """Move prescribed nodes to their positions at the end of a substep, with the corresponding velocities.

    Parameters
    ----------
    state : State
        State of the simulation; updated.
    substep : int
        Index of the substep.
    substeps : int
        Number of substeps.
    step : float, s
        Duration of the substep.
    """
    for index in range(state.status.prescribed):
        node = state.prescribed_node[index]
        fraction = 1.0 / (state.prescribed_ticks[node] * substeps - substep)
        for axis in range(3):
            before = state.prescribed_from[node, axis]
            after = before + fraction * (state.prescribed_to[node, axis] - before)
            state.velocity[node, axis] = (after - before) / step
            state.position[node, axis] = after
            state.prescribed_from[node, axis] = after


@kernel
def count_prescribed(state: State) -> None:
    """Count down the ticks that moving nodes still need, after a tick; nodes that have arrived are held.

    Parameters
    ----------
    state : State
        State of the simulation; updated.
    """
    for index in range(state.status.prescribed):
        node = state.prescribed_node[index]
        state.prescribed_ticks[node] = max(1, state.prescribed_ticks[node] - 1)
