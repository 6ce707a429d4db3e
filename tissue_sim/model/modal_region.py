"""The modal local region: nonlinear springs around the load, vibration modes everywhere else.

Freezing the rest of the organ is wrong for a body that is loaded for longer than a few
milliseconds. Here the nodes around the load move by their own springs, as in the paper's region, but
the nodes at its edge follow the organ's lowest modes, which the load drives. Only the rows that the
region's springs look at are evaluated each tick, the whole organ every few ticks.
"""

from __future__ import annotations

import math
from typing import Any

from tissue_sim.jit import kernel
from tissue_sim.model.state import DAMPING_SCALE, REGION_BOUNDARY, REGION_NODES, STIFFNESS_SCALE, TICK, TICK_TIME

SHOWN_EVERY = 8  # ticks between two evaluations of the whole organ


@kernel
def advance_modes(model: Any, state: Any, settings: Any, scratch: Any, load: Any) -> None:
    """Step every mode exactly through a tick under a constant load (n, 3) N on the region's nodes.

    q'' + c q' + w^2 q = p, with c the (uniform) nodal damping over mass.
    """
    tick_time = settings[TICK_TIME]
    rate = settings[DAMPING_SCALE] * model.damping_rate
    count = state.count[REGION_NODES]
    for k in range(len(model.mode_frequency)):
        scratch.mode_load[k] = 0.0
    for index in range(count):
        node = scratch.region_node[index]
        for c in range(3):
            if load[node, c] != 0.0:
                for k in range(len(model.mode_frequency)):
                    scratch.mode_load[k] += model.mode_shape[node, c, k] * load[node, c]
    for k in range(len(model.mode_frequency)):
        square = settings[STIFFNESS_SCALE] * model.mode_frequency[k] ** 2
        rest = scratch.mode_load[k] / square
        offset, speed = state.mode_position[k] - rest, state.mode_velocity[k]
        half = 0.5 * rate
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
        state.mode_position[k] = rest + decay * (offset * (cosine + half * sine) + speed * sine)
        state.mode_velocity[k] = decay * (speed * (cosine - half * sine) - square * offset * sine)


@kernel
def place_node(model: Any, state: Any, node: int) -> None:
    """Put a node where the modes have it."""
    for c in range(3):
        moved = 0.0
        for k in range(len(model.mode_frequency)):
            moved += model.mode_shape[node, c, k] * state.mode_position[k]
        state.position[node, c] = model.rest[node, c] + moved


@kernel
def place_boundary(model: Any, state: Any, scratch: Any) -> None:
    """Put the nodes at the region's edge where the modes have them; every few ticks all nodes outside it."""
    if state.count[TICK] % SHOWN_EVERY == 0:
        place_outside(model, state)
        return
    for index in range(state.count[REGION_BOUNDARY]):
        place_node(model, state, scratch.boundary_node[index])


@kernel
def place_outside(model: Any, state: Any) -> None:
    """Put every node outside the region where the modes have it, moving as they do."""
    for index in range(len(model.moving)):
        node = model.moving[index]
        if state.region_hop[node] < 0:
            place_node(model, state, node)
            for c in range(3):
                speed = 0.0
                for k in range(len(model.mode_frequency)):
                    speed += model.mode_shape[node, c, k] * state.mode_velocity[k]
                state.velocity[node, c] = speed


@kernel
def gather_load(state: Any, tick_time: float, load: Any) -> None:
    """What acted on the tissue from outside: last tick's contact and this tick's nodal forces, (n, 3) N."""
    for node in range(len(load)):
        for c in range(3):
            load[node, c] = state.contact_impulse[node, c] / tick_time + state.nodal_force[node, c]
            state.contact_impulse[node, c] = 0.0
