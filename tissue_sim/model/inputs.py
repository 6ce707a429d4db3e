"""What comes in from outside, taken up before a tick: by the node's loop, by a test, by a replay."""

from __future__ import annotations

from typing import Any

from tissue_sim.jit import kernel
from tissue_sim.model.arrays import copy
from tissue_sim.model.modal_region import forget_region
from tissue_sim.model.state import (
    AGE,
    ASLEEP,
    ASLEEP_TICKS,
    BACKOFF,
    CLAMPED,
    CONTACT_SEQUENCE,
    ENGAGED,
    ENTRIES,
    FAULTS,
    FORCE_AGE,
    FORCE_SEQUENCE,
    FROZEN_TICKS,
    MODAL_TICKS,
    N_LOADED,
    POSE_SEQUENCE,
    REMAINING,
    SLEWED,
    SNAPS,
    TICK,
)

LONGEST_PERIOD = 20  # ticks over which a tool is led to its newest pose at the most


@kernel
def take_pose(state: Any, tool: int, pose: Any, sequence: int) -> None:
    """Take up the newest pose (7,) of a tool: m and a unit quaternion xyzw.

    The tool is led there over as many ticks as the pose took to come, so that input slower than
    the tick rate moves it evenly.
    """
    tools = state.tool_count[tool]
    if tools[ENGAGED] == 0:
        copy(pose, state.tool_pose[tool])
        copy(pose, state.hand_pose[tool])
        tools[REMAINING] = 0
    else:
        tools[REMAINING] = min(max(tools[AGE], 1), LONGEST_PERIOD)
    copy(pose, state.tool_goal[tool])
    tools[AGE] = 0
    tools[POSE_SEQUENCE] = sequence


@kernel
def take_force(state: Any, tool: int, force: Any, sequence: int) -> None:
    """Take up the newest external force (3,) N on the tissue at a tool's tip."""
    copy(force, state.tool_force[tool])
    state.tool_count[tool, FORCE_AGE] = 0
    state.tool_count[tool, FORCE_SEQUENCE] = sequence


@kernel
def take_contacts(
    state: Any,
    entries: int,
    contact_tool: Any,
    contact_node: Any,
    contact_weight: Any,
    contact_normal: Any,
    tip_node: Any,
    tip_weight: Any,
    engaged: Any,
    sequence: int,
) -> None:
    """Take up a contact set: points (C,) on the surface that tools may touch.

    contact_tool (C,), contact_node (C, 3), contact_weight (C, 3), contact_normal (C, 3), of which
    the first `entries` count; tip_node (T, 3) and tip_weight (T, 3) the surface point under each tool's tip, node -1
    for none; engaged (T,) 1 for tools that may touch.
    """
    count = state.count
    carry_impulses(state, entries, contact_tool, contact_node, contact_weight)
    count[ENTRIES] = entries
    count[CONTACT_SEQUENCE] = sequence
    for entry in range(entries):
        state.contact_tool[entry] = contact_tool[entry]
        for c in range(3):
            state.contact_node[entry, c] = contact_node[entry, c]
            state.contact_weight[entry, c] = contact_weight[entry, c]
            state.contact_normal[entry, c] = contact_normal[entry, c]
    for tool in range(len(tip_node)):
        for c in range(3):
            state.tip_node[tool, c] = tip_node[tool, c]
            state.tip_weight[tool, c] = tip_weight[tool, c]
        state.tool_count[tool, ENGAGED] = engaged[tool] if state.tool_count[tool, AGE] >= 0 else 0


@kernel
def load_nodes(state: Any, nodes: Any, forces: Any) -> None:
    """Add forces (k, 3) N to nodes (k,) for the coming tick."""
    for index in range(len(nodes)):
        node = nodes[index]
        if state.is_loaded[node] == 0:
            state.is_loaded[node] = 1
            state.loaded_node[state.count[N_LOADED]] = node
            state.count[N_LOADED] += 1
        for c in range(3):
            state.nodal_force[node, c] += forces[index, c]


@kernel
def unload_nodes(state: Any) -> None:
    """Forget the forces of load_nodes."""
    for index in range(state.count[N_LOADED]):
        node = state.loaded_node[index]
        state.is_loaded[node] = 0
        for c in range(3):
            state.nodal_force[node, c] = 0.0
    state.count[N_LOADED] = 0


@kernel
def carry_impulses(state: Any, entries: int, contact_tool: Any, contact_node: Any, contact_weight: Any) -> None:
    """Give the points of a new contact set that were pressed in the old one their impulses of the last substep."""
    pressed, held = state.contact_pressed, state.contact_held
    pressed[1, :entries] = 0.0
    held[1, :entries] = 0.0
    for old in range(state.count[ENTRIES]):
        if pressed[0, old] <= 0.0:
            continue
        for entry in range(entries):
            same = contact_tool[entry] == state.contact_tool[old]
            for c in range(3):
                same = same and contact_node[entry, c] == state.contact_node[old, c]
                same = same and contact_weight[entry, c] == state.contact_weight[old, c]
            if same:
                pressed[1, entry] = pressed[0, old]
                copy(held[0, old], held[1, entry])
                break
    copy(pressed[1, :entries], pressed[0, :entries])
    copy(held[1, :entries], held[0, :entries])


@kernel
def reset_state(model: Any, state: Any) -> None:
    """Back to the rest shape, asleep, without tools; the counters go on."""
    tick, faults, asleep = state.count[TICK], state.count[FAULTS], state.count[ASLEEP_TICKS]
    snaps, slewed = state.count[SNAPS], state.count[SLEWED]
    frozen, modal, clamped = state.count[FROZEN_TICKS], state.count[MODAL_TICKS], state.count[CLAMPED]
    state.count[:] = 0
    state.count[TICK], state.count[FAULTS], state.count[ASLEEP_TICKS] = tick, faults, asleep
    state.count[FROZEN_TICKS], state.count[MODAL_TICKS], state.count[CLAMPED] = frozen, modal, clamped
    state.count[SNAPS], state.count[SLEWED] = snaps, slewed
    state.count[ASLEEP] = 1
    state.count[BACKOFF] = 1
    copy(model.rest, state.position)
    copy(model.rest, state.good_position)
    state.velocity[:] = 0.0
    state.nodal_force[:] = 0.0
    state.is_loaded[:] = 0
    state.is_turned[:] = 0
    state.contact_pressed[:] = 0.0
    state.contact_held[:] = 0.0
    forget_region(state)
    state.tool_goal[:] = 0.0
    state.tool_goal[:, 6] = 1.0
    copy(state.tool_goal, state.hand_pose)
    copy(state.tool_goal, state.tool_pose)
    state.tool_force[:] = 0.0
    state.wrench[:] = 0.0
    state.felt[:] = 0.0
    state.tool_count[:] = 0
    for tool in range(len(state.tool_count)):
        state.tool_count[tool, AGE] = -1
        state.tool_count[tool, FORCE_AGE] = -1
    state.tip_node[:] = -1
