"""How the bodies of tools move through a tick, and how fresh their poses and forces are."""

from __future__ import annotations

import math
from typing import Any

from tissue_sim.jit import kernel
from tissue_sim.model.arrays import copy
from tissue_sim.model.shapes import rotation_matrix

ROUNDING = 1e-6  # share of a tick that is none


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
def advance_held(state: Any, settings: Any, scratch: Any) -> None:
    """Move where each body is held towards its newest pose, and let go of it when poses stop."""
    for body in range(len(state.held_pose)):
        status = state.bodies[body]
        copy(state.held_pose[body], scratch.held[body])
        if status.age >= 0:
            status.age += 1
            if status.age * settings.tick_time > settings.stale_time + settings.ramp_time:
                status.lapsed = status.lapsed or status.engaged
                status.engaged = False
        if status.force_age >= 0:
            status.force_age += 1
        if status.remaining > 0.0:
            arrives = status.remaining < (1.0 + ROUNDING) * settings.tick_time
            share = 1.0 if arrives else settings.tick_time / status.remaining
            step_pose(state.held_pose[body], state.body_goal[body], share)
            status.remaining = 0.0 if arrives else status.remaining - settings.tick_time
        set_frame(state.held_pose[body], scratch.origin[body], scratch.rotation[body])


@kernel
def follow_held(state: Any) -> None:
    """Put every body where it is held: nothing is touched, and nobody feels anything."""
    copy(state.held_pose, state.body_pose)
    state.wrench[:] = 0.0
    state.felt[:] = 0.0


@kernel
def couple_bodies(state: Any, settings: Any, scratch: Any, step: float, share: float) -> None:
    """Lead where the bodies are held a share of its way, and each body after it through the virtual coupling.

    A body has no mass: B p' = K (h - p) + F, of which a step without contact is done here; what an impulse of the
    contact adds to it is scratch.give, m / (N s). What holds it moves evenly through the tick, so that its speed has
    no jumps.
    """
    stiffness, damping = settings.coupling_stiffness, settings.coupling_damping
    for body in range(len(state.body_pose)):
        held, pose = scratch.held[body], state.body_pose[body]
        set_frame(pose, scratch.last_origin[body], scratch.last_rotation[body])
        step_pose(held, state.held_pose[body], share)
        if stiffness > 0.0:
            scratch.give[body] = 1.0 / (damping + stiffness * step)
            for c in range(3):
                pose[c] += scratch.give[body] * stiffness * step * (held[c] - pose[c])
            copy(held[3:], pose[3:])
        else:
            scratch.give[body] = 0.0
            copy(held, pose)
        set_frame(pose, scratch.origin[body], scratch.rotation[body])


@kernel
def keep_bodies(state: Any, scratch: Any) -> None:
    """Keep where contact has pushed the tools."""
    for body in range(len(state.body_pose)):
        if scratch.give[body] > 0.0:
            copy(scratch.origin[body], state.body_pose[body, :3])


@kernel
def restore_bodies(state: Any, farthest: float) -> None:
    """Put back where they are held those bodies that contact has pushed out of all bounds, m, or to nowhere."""
    for body in range(len(state.body_pose)):
        square = 0.0
        for c in range(3):
            square += (state.body_pose[body, c] - state.held_pose[body, c]) ** 2
        if not square < farthest * farthest:
            copy(state.held_pose[body], state.body_pose[body])


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
    for body in range(len(state.body_force)):
        if state.contacts.tip_node[body, 0] >= 0 and freshness(state.bodies[body].force_age, settings) > 0.0:
            force = state.body_force[body]
            if force[0] != 0.0 or force[1] != 0.0 or force[2] != 0.0:
                return True
    return False


@kernel
def add_tip_forces(state: Any, settings: Any, force: Any) -> None:
    """Add the external forces at the tools' tips to force (n, 3) N."""
    for body in range(len(state.body_force)):
        fresh = freshness(state.bodies[body].force_age, settings)
        if fresh > 0.0 and state.contacts.tip_node[body, 0] >= 0:
            for c in range(3):
                node, weight = state.contacts.tip_node[body, c], fresh * state.contacts.tip_weight[body, c]
                for axis in range(3):
                    force[node, axis] += weight * state.body_force[body, axis]
