"""One tick: the same compiled function in the node's loop, in a test and in a replay.

inputs taken up -> anything touching or moving? -> local region or whole -> substeps
-> finite and bounded? -> wrenches
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from tissue_sim.jit import kernel
from tissue_sim.model import local_region, modal_region
from tissue_sim.model.contact_constraint import is_touched, resolve_contacts
from tissue_sim.model.forces import angular_forces, return_forces, spring_forces
from tissue_sim.model.guard import guard
from tissue_sim.model.implied_boundary import imply_boundary
from tissue_sim.model.integrators import symplectic_euler
from tissue_sim.model.state import (
    ACTIVE,
    AGE,
    ASLEEP,
    ASLEEP_TICKS,
    BACKOFF,
    CLAMPED,
    DAMPING_SCALE,
    FORCE_AGE,
    FORCE_CLAMP,
    FRICTION,
    FROZEN,
    FROZEN_TICKS,
    LOADED,
    LOCAL_REGION,
    MODAL,
    MODAL_TICKS,
    QUIET,
    REGION,
    REGION_FORCE,
    REGION_NODES,
    SNAPPED,
    SNAPS,
    STIFFNESS_SCALE,
    SUBSTEPS,
    TICK,
    TICK_TIME,
    TOUCHING,
    WANTED_SUBSTEPS,
    WHOLE,
)
from tissue_sim.model.tool_motion import (
    add_tip_forces,
    advance_tools,
    freshness,
    has_tip_force,
    set_frame,
    step_pose,
)

QUIET_SPEED = 2e-5  # m/s
QUIET_DISPLACEMENT = 5e-6  # m
QUIET_TICKS = 20
TREMBLING = 1.0  # 1/s, speed over displacement; a sound organ goes back at 20 or so
SNAPPED_DISPLACEMENT = 2e-4  # m; a sound organ that far from rest is moving
WAY_BACK = 0.02  # share of the way to rest in a tick
CONTACT_ITERATIONS = 8

# Values of settings[LOCAL_REGION]; 0 is off.
FROZEN_SMALL, MODAL_ALWAYS, MODAL_SMALL = 1.0, 2.0, 3.0


class Scratch(NamedTuple):
    """Working arrays of a tick; nothing in them outlives it except the region's lists."""

    force: Any  # (n, 3) N
    impulse: Any  # (T, 6) N s on the tissue
    mobility: Any  # (n,) 1/kg
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
    if count[SNAPPED] == 1:
        if not forced and not is_touched(state, shapes, scratch.origin, scratch.rotation):
            lead_back(model, state)
            state.wrench[:] = 0.0
            return
        count[SNAPPED] = 0
    if len(model.spokes.parent) > 0:
        imply_boundary(model.spokes, state.position, model.return_target)
    if count[REGION] == WHOLE:
        count[ACTIVE] = len(model.moving)
    else:
        prepare_region(model, state, settings, scratch)

    scratch.impulse[:] = 0.0
    substeps = int(settings[WANTED_SUBSTEPS]) * count[BACKOFF]
    count[SUBSTEPS] = substeps
    set_mobility(model, settings, settings[TICK_TIME] / substeps, scratch.mobility)
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
        state, shapes, scratch.mobility, scratch, settings[FRICTION], step, CONTACT_ITERATIONS
    )


@kernel
def set_mobility(model: Any, settings: Any, step: float, mobility: Any) -> None:
    """Velocity that an impulse gives each node within a substep, (n,) 1/kg.

    The damping is implicit, so it meets the contact's impulse too: 1 / (m + h d). With 1/m alone
    a body at rest would press with a force short by h d/m.
    """
    for index in range(len(model.moving)):
        node = model.moving[index]
        inverse = model.inverse_mass[node]
        mobility[node] = inverse / (1.0 + step * inverse * settings[DAMPING_SCALE] * model.damping[node])


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
    return_forces(position, model.return_target, model.return_nodes, model.return_stiffness, force)


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
    """Fall asleep after a number of ticks without touch, load, speed and displacement.

    Springs pushed through each other can come to rest in a false shape, finite and still. An organ that
    nobody touches and that stands still away from its rest shape is led back to it.
    """
    count = state.count
    if forced or count[TOUCHING] > 0:
        count[QUIET] = 0
        return
    speed, displacement = 0.0, 0.0
    for index in range(len(model.moving)):
        node = model.moving[index]
        for c in range(3):
            speed = max(speed, abs(state.velocity[node, c]))
            displacement = max(displacement, abs(state.position[node, c] - model.rest[node, c]))
    # Far from rest, a false shape may tremble for good; slow is what wouldn't get back within seconds.
    if speed > max(QUIET_SPEED, TREMBLING * displacement):
        count[QUIET] = 0
        return
    count[QUIET] += 1
    if displacement <= QUIET_DISPLACEMENT:
        if count[QUIET] >= QUIET_TICKS and speed <= QUIET_SPEED:
            count[ASLEEP] = 1
            count[BACKOFF] = 1
    elif count[QUIET] >= QUIET_TICKS and displacement > SNAPPED_DISPLACEMENT:
        count[SNAPPED] = 1
        count[SNAPS] += 1


@kernel
def lead_back(model: Any, state: Any) -> None:
    """A step of the way back from a false rest shape, without forces: they hold the organ in it."""
    displacement = 0.0
    for index in range(len(model.moving)):
        node = model.moving[index]
        for c in range(3):
            offset = (1.0 - WAY_BACK) * (state.position[node, c] - model.rest[node, c])
            state.position[node, c] = model.rest[node, c] + offset
            state.velocity[node, c] = 0.0
            displacement = max(displacement, abs(offset))
    # A fault on the way must not restore the false shape.
    state.good_position[:] = state.position
    state.good_velocity[:] = 0.0
    if displacement <= QUIET_DISPLACEMENT:
        state.count[SNAPPED] = 0
        state.count[QUIET] = 0
