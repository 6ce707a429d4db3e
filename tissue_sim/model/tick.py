"""One tick: the same compiled function in the node's loop, in a test and in a replay.

inputs taken up -> anything touching or moving? -> local region or whole -> substeps
-> finite and bounded? -> wrenches
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from tissue_sim.model import local_region, modal_region
from tissue_sim.model.contact_constraint import is_touched, resolve_contacts
from tissue_sim.model.forces import angular_forces, return_forces, spring_forces
from tissue_sim.model.integrators import symplectic_euler
from tissue_sim.model.jit import kernel
from tissue_sim.model.shapes import rotation_matrix
from tissue_sim.model.state import (
    ACTIVE,
    AGE,
    ASLEEP,
    ASLEEP_TICKS,
    BACKOFF,
    CLAMPED,
    DAMPING_SCALE,
    ENGAGED,
    FAULTS,
    FORCE_AGE,
    FORCE_CLAMP,
    FRICTION,
    FROZEN,
    FROZEN_TICKS,
    LAST_GOOD_SPAN,
    LOADED,
    LOCAL_REGION,
    MODAL,
    MODAL_TICKS,
    QUIET,
    RAMP_TIME,
    REGION,
    REGION_FORCE,
    REGION_NODES,
    REMAINING,
    STALE_TIME,
    STIFFNESS_SCALE,
    SUBSTEPS,
    TICK,
    TICK_TIME,
    TOUCHING,
    WANTED_SUBSTEPS,
    WHOLE,
)

QUIET_SPEED = 2e-5  # m/s
QUIET_DISPLACEMENT = 5e-6  # m
QUIET_TICKS = 20
MAX_BACKOFF = 8
CONTACT_ITERATIONS = 8

# Values of settings[LOCAL_REGION]; 0 is off.
FROZEN_SMALL, MODAL_ALWAYS, MODAL_SMALL = 1.0, 2.0, 3.0


class Scratch(NamedTuple):
    """Working arrays of a tick; nothing in them outlives it except the region's lists."""

    force: Any  # (n, 3) N
    impulse: Any  # (T, 6) N s on the tissue
    origin: Any  # (T, 3) m at the substep's end
    rotation: Any  # (T, 9)
    last_origin: Any  # (T, 3) at its beginning
    last_rotation: Any  # (T, 9)
    start_pose: Any  # (T, 7) at the tick's beginning
    near_entry: Any  # (N,) contact points resolved in this substep
    near_normal: Any  # (N,) N s
    near_tangent: Any  # (N, 3) N s
    load: Any  # (n, 3) N that drives the modes
    mode_load: Any  # (m,)
    mark: Any  # (n,)
    boundary_node: Any
    region_node: Any
    region_first: Any
    region_second: Any
    region_rest_length: Any
    region_stiffness: Any
    region_angular_nodes: Any
    region_angular_weight: Any
    region_angular_rest: Any
    region_angular_stiffness: Any
    region_angular_least_area: Any
    stale: Any  # (1,) 1 when the region's lists have to be made again


@kernel
def tick(model: Any, state: Any, shapes: Any, settings: Any, scratch: Any) -> None:
    """Advance the organ by one tick of settings[TICK_TIME] seconds."""
    count = state.count
    count[TICK] += 1
    advance_tools(state, settings, scratch)
    forced = count[LOADED] == 1 or has_tip_force(state, settings)
    count[TOUCHING] = 0
    if count[ASLEEP] == 1:
        if not forced and not is_touched(state, shapes, scratch.origin, scratch.rotation):
            state.wrench[:] = 0.0
            count[ASLEEP_TICKS] += 1
            count[ACTIVE] = 0
            return
        count[ASLEEP] = 0
        count[QUIET] = 0
        choose_region(state, settings)
    if count[REGION] == WHOLE:
        count[ACTIVE] = len(model.moving)
    else:
        prepare_region(model, state, settings, scratch)

    scratch.impulse[:] = 0.0
    substeps = int(settings[WANTED_SUBSTEPS]) * count[BACKOFF]
    count[SUBSTEPS] = substeps
    for substep in range(substeps):
        advance_substep(model, state, shapes, settings, scratch, substep, substeps)
    guard(model, state, settings, scratch)
    report_wrenches(state, settings, scratch)
    if count[REGION] != WHOLE and settings[LOCAL_REGION] != MODAL_ALWAYS:
        if total_load(state, settings) > settings[REGION_FORCE]:
            leave_region(model, state)
    if count[LOADED] == 1:
        state.nodal_force[:] = 0.0
        count[LOADED] = 0
    rest_if_quiet(model, state, forced)


@kernel
def advance_tools(state: Any, settings: Any, scratch: Any) -> None:
    """Move each tool towards its newest pose, and let go of it when poses stop."""
    for tool in range(len(state.tool_pose)):
        tools = state.tool_count[tool]
        scratch.start_pose[tool] = state.tool_pose[tool]
        if tools[AGE] >= 0:
            tools[AGE] += 1
            if tools[AGE] * settings[TICK_TIME] > settings[STALE_TIME] + settings[RAMP_TIME]:
                tools[ENGAGED] = 0
        if tools[FORCE_AGE] >= 0:
            tools[FORCE_AGE] += 1
        if tools[REMAINING] > 0:
            share = 1.0 / tools[REMAINING]
            step_pose(state.tool_pose[tool], state.tool_goal[tool], share)
            tools[REMAINING] -= 1
        set_frame(state.tool_pose[tool], scratch.origin[tool], scratch.rotation[tool])


@kernel
def step_pose(pose: Any, goal: Any, share: float) -> None:
    """Move a pose (7,) by a share of the way to a goal; the quaternion by normalised lerp."""
    if share >= 1.0:
        pose[:] = goal
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
    origin[:] = pose[:3]
    rotation_matrix(pose[3:], rotation)


@kernel
def freshness(age: int, settings: Any) -> float:
    """1 while an input is fresh, ramping to 0 after it went stale; 0 when there was none."""
    if age < 0:
        return 0.0
    late = age * settings[TICK_TIME] - settings[STALE_TIME]
    if late <= 0.0:
        return 1.0
    return max(0.0, 1.0 - late / settings[RAMP_TIME])


@kernel
def has_tip_force(state: Any, settings: Any) -> bool:
    """True when an external force acts on the tissue under any tool's tip."""
    for tool in range(len(state.tool_force)):
        if state.tip_node[tool, 0] >= 0 and freshness(state.tool_count[tool, FORCE_AGE], settings) > 0.0:
            force = state.tool_force[tool]
            if force[0] != 0.0 or force[1] != 0.0 or force[2] != 0.0:
                return True
    return False


@kernel
def choose_region(state: Any, settings: Any) -> None:
    """On waking: a local region if asked for, else the whole model."""
    state.region_hop[:] = -1
    state.contact_impulse[:] = 0.0
    state.mode_position[:] = 0.0
    state.mode_velocity[:] = 0.0
    if settings[LOCAL_REGION] == FROZEN_SMALL:
        state.count[REGION] = FROZEN
    elif settings[LOCAL_REGION] in (MODAL_ALWAYS, MODAL_SMALL):
        state.count[REGION] = MODAL
    else:
        state.count[REGION] = WHOLE


@kernel
def prepare_region(model: Any, state: Any, settings: Any, scratch: Any) -> None:
    """Grow the local region to what is loaded, and move its edge."""
    count = state.count
    grown = local_region.mark_loaded(model, state)
    if grown:
        if count[REGION] == MODAL:
            modal_region.place_outside(model, state)
        local_region.spread(model, state)
    if grown or scratch.stale[0] == 1:
        local_region.collect(model, state, scratch)
        scratch.stale[0] = 0
    count[ACTIVE] = count[REGION_NODES]
    if count[REGION] == FROZEN:
        count[FROZEN_TICKS] += 1
        return
    count[MODAL_TICKS] += 1
    modal_region.gather_load(state, settings[TICK_TIME], scratch.load)
    add_tip_forces(state, settings, scratch.load)
    modal_region.advance_modes(model, state, settings, scratch, scratch.load)
    modal_region.place_boundary(model, state, scratch)


@kernel
def leave_region(model: Any, state: Any) -> None:
    """From here on the whole model moves, from where the region and the modes have it."""
    if state.count[REGION] == MODAL:
        modal_region.place_outside(model, state)
    state.count[REGION] = WHOLE


@kernel
def advance_substep(
    model: Any, state: Any, shapes: Any, settings: Any, scratch: Any, substep: int, substeps: int
) -> None:
    """Forces, integration and contact of one substep."""
    step = settings[TICK_TIME] / substeps
    for tool in range(len(state.tool_pose)):
        # The tool moves evenly through the tick, so that its speed holds no jumps.
        pose = scratch.start_pose[tool]
        set_frame(pose, scratch.last_origin[tool], scratch.last_rotation[tool])
        step_pose(pose, state.tool_pose[tool], 1.0 / (substeps - substep))
        set_frame(pose, scratch.origin[tool], scratch.rotation[tool])
    scratch.force[:] = 0.0
    if state.count[REGION] != WHOLE:
        nodes = scratch.region_node[: state.count[REGION_NODES]]
        local_region.elastic_forces(model, state, scratch)
    else:
        nodes = model.moving
        elastic_forces(model, state.position, scratch.force)
    add_loads(state, settings, scratch.force)
    symplectic_euler(
        state.position,
        state.velocity,
        scratch.force,
        nodes,
        model.inverse_mass,
        model.damping,
        settings[DAMPING_SCALE],
        step,
    )
    state.count[TOUCHING] = resolve_contacts(
        state, shapes, model.inverse_mass, scratch, settings[FRICTION], step, CONTACT_ITERATIONS
    )


@kernel
def elastic_forces(model: Any, position: Any, force: Any) -> None:
    """Add the forces of every spring of the model to force (n, 3) N."""
    spring_forces(
        position,
        model.spring_first,
        model.spring_second,
        model.spring_rest_length,
        model.spring_stiffness,
        force,
    )
    angular_forces(
        position,
        model.angular_nodes,
        model.angular_weight,
        model.angular_rest,
        model.angular_stiffness,
        model.angular_least_area,
        force,
    )
    return_forces(position, model.rest, model.return_nodes, model.return_stiffness, force)


@kernel
def add_loads(state: Any, settings: Any, force: Any) -> None:
    """Scale the elastic forces by the tissue's stiffness and add the external ones."""
    scale = settings[STIFFNESS_SCALE]
    if scale != 1.0:
        for node in range(len(force)):
            for c in range(3):
                force[node, c] *= scale
    if state.count[LOADED] == 1:
        for node in range(len(force)):
            for c in range(3):
                force[node, c] += state.nodal_force[node, c]
    add_tip_forces(state, settings, force)


@kernel
def add_tip_forces(state: Any, settings: Any, force: Any) -> None:
    """Add the external forces at the tools' tips to force (n, 3) N."""
    for tool in range(len(state.tool_force)):
        fresh = freshness(state.tool_count[tool, FORCE_AGE], settings)
        if fresh > 0.0 and state.tip_node[tool, 0] >= 0:
            for c in range(3):
                node, weight = state.tip_node[tool, c], fresh * state.tip_weight[tool, c]
                for axis in range(3):
                    force[node, axis] += weight * state.tool_force[tool, axis]


@kernel
def guard(model: Any, state: Any, settings: Any, scratch: Any) -> None:
    """Keep this state if it is finite and bounded, else go back to the last good one, at rest.

    After a fault the substeps double (up to 8 times), until the organ has slept.
    """
    span = settings[LAST_GOOD_SPAN] * settings[LAST_GOOD_SPAN]
    speed = span / (settings[TICK_TIME] * settings[TICK_TIME])
    good = True
    for index in range(len(model.moving)):
        node = model.moving[index]
        moved = sped = 0.0
        for c in range(3):
            offset = state.position[node, c] - model.rest[node, c]
            moved += offset * offset
            sped += state.velocity[node, c] * state.velocity[node, c]
        # Comparisons with NaN are false, so this catches it too.
        good = good and moved < span and sped < speed
    if good:
        state.good_position[:] = state.position
        state.good_velocity[:] = state.velocity
        return
    state.position[:] = state.good_position
    state.velocity[:] = 0.0
    state.good_velocity[:] = 0.0
    scratch.impulse[:] = 0.0
    state.count[FAULTS] += 1
    state.count[BACKOFF] = min(MAX_BACKOFF, 2 * state.count[BACKOFF])


@kernel
def report_wrenches(state: Any, settings: Any, scratch: Any) -> None:
    """What each hand should feel: minus the mean force on the tissue, faded when stale, clamped."""
    cut = False
    for tool in range(len(state.wrench)):
        scale = -freshness(state.tool_count[tool, AGE], settings) / settings[TICK_TIME]
        size = 0.0
        for c in range(3):
            size += (scale * scratch.impulse[tool, c]) ** 2
        size = math.sqrt(size)
        if size > settings[FORCE_CLAMP]:
            scale *= settings[FORCE_CLAMP] / size
            cut = True
        for c in range(6):
            state.wrench[tool, c] = scale * scratch.impulse[tool, c]
    if cut:
        state.count[CLAMPED] += 1


@kernel
def total_load(state: Any, settings: Any) -> float:
    """Sum of the magnitudes of contact, nodal and external tool forces, N."""
    load = 0.0
    if state.count[LOADED] == 1:
        for node in range(len(state.nodal_force)):
            force = state.nodal_force[node]
            load += math.sqrt(force[0] ** 2 + force[1] ** 2 + force[2] ** 2)
    for tool in range(len(state.wrench)):
        load += math.sqrt(state.wrench[tool, 0] ** 2 + state.wrench[tool, 1] ** 2 + state.wrench[tool, 2] ** 2)
        if state.tip_node[tool, 0] >= 0:
            force = state.tool_force[tool]
            fresh = freshness(state.tool_count[tool, FORCE_AGE], settings)
            load += fresh * math.sqrt(force[0] ** 2 + force[1] ** 2 + force[2] ** 2)
    return load


@kernel
def rest_if_quiet(model: Any, state: Any, forced: bool) -> None:
    """Fall asleep after a number of ticks without touch, load, speed and displacement."""
    count = state.count
    if forced or count[TOUCHING] > 0:
        count[QUIET] = 0
        return
    for index in range(len(model.moving)):
        node = model.moving[index]
        for c in range(3):
            if (
                abs(state.velocity[node, c]) > QUIET_SPEED
                or abs(state.position[node, c] - model.rest[node, c]) > QUIET_DISPLACEMENT
            ):
                count[QUIET] = 0
                return
    count[QUIET] += 1
    if count[QUIET] >= QUIET_TICKS:
        count[ASLEEP] = 1
        count[BACKOFF] = 1
