"""How hands and their tools move through a tick, and how fresh their poses and forces are."""

from __future__ import annotations

import math
from typing import Any

from tissue_sim.jit import kernel
from tissue_sim.model.arrays import copy
from tissue_sim.model.shapes import rotation_matrix


@kernel
def freshness(age: int, settings: Any) -> float:
    """1 while an input is fresh, ramping to 0 after it went stale; 0 when there was none."""
    if age < 0:
        return 0.0
    late = age * settings.tick_time - settings.stale_time
    if late <= 0.0:
        return 1.0
    return max(0.0, 1.0 - late / settings.ramp_time)


@kernel
def advance_hands(state: Any, settings: Any, scratch: Any) -> None:
    """Move each hand towards its newest pose, and let go of its tool when poses stop."""
    for tool in range(len(state.hand_pose)):
        tools = state.tools[tool]
        copy(state.hand_pose[tool], scratch.hand[tool])
        if tools.age >= 0:
            tools.age += 1
            if tools.age * settings.tick_time > settings.stale_time + settings.ramp_time:
                tools.engaged = 0
        if tools.force_age >= 0:
            tools.force_age += 1
        if tools.remaining > 0:
            share = 1.0 / tools.remaining
            step_pose(state.hand_pose[tool], state.tool_goal[tool], share)
            tools.remaining -= 1
        set_frame(state.hand_pose[tool], scratch.origin[tool], scratch.rotation[tool])


@kernel
def follow_hands(state: Any) -> None:
    """Put every tool where its hand is: nothing is touched, and nobody feels anything."""
    copy(state.hand_pose, state.tool_pose)
    state.wrench[:] = 0.0
    state.felt[:] = 0.0


@kernel
def hold_tools(state: Any, settings: Any, scratch: Any, step: float, share: float) -> None:
    """Lead the hands a share of their way, and each tool after its hand through the virtual coupling.

    The tool has no mass: B p' = K (h - p) + F, of which a step without contact is done here; what an impulse of the
    contact adds to it is scratch.give, m / (N s). The hand moves evenly through the tick, so that its speed holds no
    jumps.
    """
    stiffness, damping = settings.coupling_stiffness, settings.coupling_damping
    for tool in range(len(state.tool_pose)):
        hand, pose = scratch.hand[tool], state.tool_pose[tool]
        set_frame(pose, scratch.last_origin[tool], scratch.last_rotation[tool])
        step_pose(hand, state.hand_pose[tool], share)
        if stiffness > 0.0:
            scratch.give[tool] = 1.0 / (damping + stiffness * step)
            for c in range(3):
                pose[c] += scratch.give[tool] * stiffness * step * (hand[c] - pose[c])
            copy(hand[3:], pose[3:])
        else:
            scratch.give[tool] = 0.0
            copy(hand, pose)
        set_frame(pose, scratch.origin[tool], scratch.rotation[tool])


@kernel
def keep_tools(state: Any, scratch: Any) -> None:
    """Keep where contact has pushed the tools."""
    for tool in range(len(state.tool_pose)):
        if scratch.give[tool] > 0.0:
            copy(scratch.origin[tool], state.tool_pose[tool, :3])


@kernel
def step_pose(pose: Any, goal: Any, share: float) -> None:
    """Move a pose (7,) by a share of the way to a goal; the quaternion by normalised lerp."""
    if share >= 1.0:
        copy(goal, pose)
        return
    for c in range(3):
        pose[c] += share * (goal[c] - pose[c])
    dot = pose[3] * goal[3] + pose[4] * goal[4] + pose[5] * goal[5] + pose[6] * goal[6]
    sign = 1.0 if dot >= 0.0 else -1.0
    norm = 0.0
    for c in range(3, 7):
        pose[c] += share * (sign * goal[c] - pose[c])
        norm += pose[c] * pose[c]
    norm = 1.0 / math.sqrt(norm)
    for c in range(3, 7):
        pose[c] *= norm


@kernel
def set_frame(pose: Any, origin: Any, rotation: Any) -> None:
    """Origin (3,) and rotation matrix (9,) of a pose (7,)."""
    copy(pose[:3], origin)
    rotation_matrix(pose[3:], rotation)


@kernel
def has_tip_force(state: Any, settings: Any) -> bool:
    """True when an external force acts on the tissue under any tool's tip."""
    for tool in range(len(state.tool_force)):
        if state.contacts.tip_node[tool, 0] >= 0 and freshness(state.tools[tool].force_age, settings) > 0.0:
            force = state.tool_force[tool]
            if force[0] != 0.0 or force[1] != 0.0 or force[2] != 0.0:
                return True
    return False


@kernel
def add_tip_forces(state: Any, settings: Any, force: Any) -> None:
    """Add the external forces at the tools' tips to force (n, 3) N."""
    for tool in range(len(state.tool_force)):
        fresh = freshness(state.tools[tool].force_age, settings)
        if fresh > 0.0 and state.contacts.tip_node[tool, 0] >= 0:
            for c in range(3):
                node, weight = state.contacts.tip_node[tool, c], fresh * state.contacts.tip_weight[tool, c]
                for axis in range(3):
                    force[node, axis] += weight * state.tool_force[tool, axis]
