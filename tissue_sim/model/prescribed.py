"""Nodes that are led: where they are is prescribed, and what holds them there follows."""

from __future__ import annotations

from typing import Any

from tissue_sim.jit import kernel


@kernel
def prescribe_nodes(state: Any, nodes: Any, positions: Any, ticks: int) -> None:
    """From the next tick on lead nodes (k,) evenly to positions (k, 3) m within so many ticks, and hold them there."""
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
def free_nodes(model: Any, state: Any) -> None:
    """Let prescribed nodes go, with the speed that they have; those that the organ is held at stay where they are."""
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
def forget_prescribed(state: Any) -> None:
    """Nothing is prescribed from here on."""
    state.is_prescribed[:] = 0
    state.status.prescribed = 0
    state.status.prescriptions += 1


@kernel
def lead_prescribed(state: Any, substep: int, substeps: int, step: float) -> None:
    """Put prescribed nodes where they are to be at the end of a substep, s, with the speed that leads them there."""
    for index in range(state.status.prescribed):
        node = state.prescribed_node[index]
        share = 1.0 / (state.prescribed_ticks[node] * substeps - substep)
        for axis in range(3):
            before = state.prescribed_from[node, axis]
            after = before + share * (state.prescribed_to[node, axis] - before)
            state.velocity[node, axis] = (after - before) / step
            state.position[node, axis] = after
            state.prescribed_from[node, axis] = after


@kernel
def count_prescribed(state: Any) -> None:
    """After a tick: one less is left for nodes on their way; those that are there are held."""
    for index in range(state.status.prescribed):
        node = state.prescribed_node[index]
        state.prescribed_ticks[node] = max(1, state.prescribed_ticks[node] - 1)
