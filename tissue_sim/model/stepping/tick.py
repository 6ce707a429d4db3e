"""One tick: the same compiled function in the node's loop, in a test and in a replay.

Its order is: inputs are applied; if nothing touches or moves, the tick ends; a local region or the whole organ is
chosen; the substeps are computed; positions are checked to be finite and bounded; wrenches are computed.
"""

from __future__ import annotations

from typing import Any

from tissue_sim.handles import has
from tissue_sim.jit import chosen, kernel, part
from tissue_sim.model.contact.constraint import add_contact_impulses, carry_force, resolve_contacts
from tissue_sim.model.contact.culling import cull_contacts
from tissue_sim.model.contact.haptic_output import compute_haptic_output
from tissue_sim.model.contact.tool_motion import (
    add_tip_forces,
    advance_held,
    couple_bodies,
    follow_untouched,
    has_tip_force,
    note_forces,
    slip_substep_factor,
    store_body_poses,
)
from tissue_sim.model.contact.volume_limit import has_compressed_cells
from tissue_sim.model.contact.walls import find_walls, press_walls
from tissue_sim.model.data.arrays import copy
from tissue_sim.model.data.model import Model
from tissue_sim.model.data.settings import Integrator, Settings
from tissue_sim.model.data.state import Region, State
from tissue_sim.model.data.world import World
from tissue_sim.model.elasticity.forces import elastic_forces
from tissue_sim.model.elasticity.gravity import add_weight, is_out_of_balance, write_masses
from tissue_sim.model.elasticity.stiffening import shortening_of
from tissue_sim.model.regions.active_region import (
    absorb_load,
    change_region,
    choose_region,
    damping_of,
    inertia_of,
    prepare_region,
    region_forces,
)
from tissue_sim.model.regions.moved_nodes import integrated_nodes
from tissue_sim.model.stepping.guard import check_cells, guard
from tissue_sim.model.stepping.inputs import unload_nodes
from tissue_sim.model.stepping.integrators import explicit_euler, symplectic_euler, symplectic_euler_whole
from tissue_sim.model.stepping.mass_scaling import can_be_cut, is_mass_scaled, write_mass_factors
from tissue_sim.model.stepping.oscillation import begin_oscillation_check, end_oscillation_check, is_oscillation_checked
from tissue_sim.model.stepping.prescribed import count_prescribed, move_prescribed
from tissue_sim.model.stepping.relaxation import relax
from tissue_sim.model.stepping.rest_recovery import sleep_if_at_rest, sleep_or_recover, step_recovery

MANY_INVERTED = 0.02  # fraction of inverted cells from which a tick takes four times its substeps


@kernel
def tick(world: World) -> None:
    """Advance the organ by one tick of settings.tick_time seconds.

    Parameters
    ----------
    world : World
        Model, state, shapes, settings and working memory; updated.
    """
    plan = world.scratch.plan
    plan.handled = world.state.status.loaded > 0
    if not plan_tick(world):
        return
    begin_tick(world)
    for substep in range(plan.substeps):
        take_substep(world, substep)
    end_tick(world)


@part
def plan_tick(world: World) -> bool:
    """Return whether there is anything to advance, and write the plan of the tick to scratch.plan.

    scratch.plan.handled is set if nodes were loaded before links and other organs loaded them.
    """
    model, state, shapes = world.model, world.state, world.shapes
    settings, scratch = world.settings, world.scratch
    status, count, plan = state.status, state.count, scratch.plan
    status.tick += 1
    advance_held(state, settings, scratch)
    find_walls(model, state, scratch)
    plan.handled = plan.handled or has_tip_force(state, settings) or status.prescribed > 0
    plan.forced = plan.handled or status.loaded > 0 or is_out_of_balance(model, settings)
    plan.coarse = False
    status.touching = 0
    if status.asleep:
        if not plan.forced and follow_untouched(state, shapes, settings, scratch):
            count.asleep_ticks += 1
            status.active = 0
            return False
        status.asleep = False
        status.quiet = status.alone = 0
        choose_region(model, state, settings, scratch)
    if status.snapped:
        if not plan.handled and follow_untouched(state, shapes, settings, scratch):
            step_recovery(model, state, settings)
            check_cells(model, state, scratch)
            return False
        status.snapped = False
    prepare_region(model, state, settings, scratch)
    if status.region == Region.WHOLE:
        status.active = len(model.moving)

    scratch.impulse[:] = 0.0
    # The first forces show how stiff the cells are.
    plan.whole = status.region == Region.WHOLE
    if plan.whole:
        elastic_forces(model, state.position, settings.stiffness_scale, scratch.force)
    plan.regional = is_region_of_cells(model, state)
    if plan.regional:
        region_forces(model, state, settings, scratch, False)
    wanted = settings.substeps if plan.whole else settings.region_substeps
    plan.mass_scaled = is_mass_scaled(model, state)
    factor = substep_factor(model, state, plan.whole or plan.regional)
    plan.substeps = wanted * status.backoff * max(factor, slip_substep_factor(state))
    plan.is_checked = plan.whole and is_oscillation_checked(model, state, plan.substeps)
    plan.is_checked = plan.is_checked and (factor == 1 or can_be_cut(model, state))
    return True


@part
def begin_tick(world: World) -> None:
    """Prepare the substeps of the plan.

    Parameters
    ----------
    world : World
        Model, state, shapes, settings and working memory; updated.
    """
    state, settings, scratch = world.state, world.settings, world.scratch
    status, plan = state.status, scratch.plan
    carry_force(state, status.substeps, plan.substeps)
    status.substeps = plan.substeps
    set_mobility(world, settings.tick_time / plan.substeps)
    cull_contacts(state, world.shapes, settings, scratch)


@kernel
def take_substep(world: World, substep: int) -> None:
    """Advance by one substep of the plan: forces, integration and contact."""
    model, state, shapes = world.model, world.state, world.shapes
    settings, scratch, plan = world.settings, world.scratch, world.scratch.plan
    substeps, first = plan.substeps, substep == 0
    if plan.is_checked and substep == substeps - 1:
        begin_oscillation_check(state, scratch)
    # The last substep of a region computes more.
    known = first and (plan.whole or (plan.regional and substeps > 1))
    step = settings.tick_time / substeps
    couple_bodies(state, shapes, settings, scratch, step, 1.0 / (substeps - substep))
    if not known:
        if state.status.region != Region.WHOLE:
            region_forces(model, state, settings, scratch, substep == substeps - 1)
        else:
            elastic_forces(model, state.position, settings.stiffness_scale, scratch.force)
    if len(state.relaxing) > 0:
        relax(model, state, scratch.force, step)
    add_loads(world)
    integrate(world, step)
    move_prescribed(state, substep, substeps, step)
    pushed = has_taken_impulses(state, settings)
    state.status.touching = resolve_contacts(world, step, pushed)
    if scratch.n_walls[0] > 0:
        press_walls(state, scratch, step)
    store_body_poses(state, scratch)


@part
def end_tick(world: World) -> None:
    """Check the result of the substeps, compute the wrenches, and let an organ fall asleep on which nothing acts.

    Parameters
    ----------
    world : World
        Model, state, shapes, settings and working memory; updated.
    """
    model, state, shapes = world.model, world.state, world.shapes
    settings, scratch = world.settings, world.scratch
    status, plan = state.status, scratch.plan
    if plan.is_checked:
        end_oscillation_check(state, scratch)
    absorb_load(model, state, settings, scratch)
    guard(model, state, settings, scratch)
    check_cells(model, state, scratch)
    count_prescribed(state)
    note_forces(state, settings, scratch)
    compute_haptic_output(state, shapes, settings, scratch)
    change_region(world)
    unload_nodes(state)
    status.alone = 0 if plan.handled or status.touching > 0 else status.alone + 1
    if status.alone > 0:
        sleep_or_recover(model, state, settings, scratch)
    elif not plan.forced and status.touching == 0:
        sleep_if_at_rest(model, state, scratch)


@kernel
def _in_a_region(model: Model, state: State) -> bool:
    return state.status.region != Region.WHOLE


@kernel
def _in_none(model: Model, state: State) -> bool:
    return False


@chosen(lambda model, *_: _in_a_region if has(model, "tissue") and has(model, "adjacency") else _in_none)
def is_region_of_cells(model: Model, state: State) -> Any:
    """Return whether this tick moves only the cells around a load."""


@kernel
def substep_factor(model: Model, state: State, begun: bool) -> int:
    """Return the factor on the substeps while cells are stretched, compressed or inverted, or nodes oscillate.

    All of these make cells stiffer. begun: the forces of this tick's first substep are known.
    """
    least = shortening_of(model) if begun else 1
    factor = 2 if begun and has_compressed_cells(model) else 1
    if state.status.turned > 0:
        factor = 4 if state.status.turned > MANY_INVERTED * len(model.cells) else 2
    doubled = factor == 2 and can_be_cut(model, state) and not is_mass_scaled(model, state)
    if state.status.oscillating > 0 and (factor == 1 or doubled):
        factor *= 2
    return max(least, factor)


@kernel
def integrate(world: World, step: float) -> None:
    """Move the nodes by scratch.force for a step, s."""
    model, state, settings, scratch = world.model, world.state, world.settings, world.scratch
    scale, inertia = damping_of(state, settings), inertia_of(state, settings)
    if has_taken_impulses(state, settings):
        add_contact_impulses(state, world.shapes, scratch, 1.0 / step, scratch.force)
        size = state.position.size
        x, v, f = state.position.reshape(size), state.velocity.reshape(size), scratch.force.reshape(size)
        symplectic_euler_whole(x, v, f, scratch.push, scratch.shrink, step)
        return
    nodes = integrated_nodes(model, state, scratch)
    if settings.integrator == Integrator.EXPLICIT:
        explicit_euler(
            state.position,
            state.velocity,
            scratch.force,
            nodes,
            model.inverse_mass,
            model.damping,
            scale,
            step,
        )
    else:
        symplectic_euler(
            state.position,
            state.velocity,
            scratch.force,
            nodes,
            model.inverse_mass,
            model.damping,
            scale * inertia,
            step,
            inertia,
        )


@kernel
def has_taken_impulses(state: State, settings: Settings) -> bool:
    """Return whether the integrator applies the last contact impulses; while they persist, nothing need be resolved."""
    return settings.integrator != Integrator.EXPLICIT and state.status.region == Region.WHOLE


@kernel
def set_mobility(world: World, step: float) -> None:
    """Write each node's velocity for a unit impulse in a substep, (n,) 1/kg, and the factors of the integrator.

    They are computed only when settings or masses have changed. The damping is implicit, so it also acts on the
    contact's impulse: 1 / (m + h d). With 1/m alone, the force of a body at rest would be too small by h d/m.
    """
    model, state, settings, scratch = world.model, world.state, world.settings, world.scratch
    key, damping, inertia = scratch.mobility_key, damping_of(state, settings), inertia_of(state, settings)
    changes, coarse, scaled = state.status.prescriptions, scratch.plan.coarse, scratch.plan.mass_scaled
    same = key.step == step and key.damping == damping and key.inertia == inertia
    same = same and key.prescriptions == changes and key.coarse == coarse
    if same and not scaled and not key.mass_scaled:
        return
    factor, last = scratch.coarse if coarse else scratch.mass_factor, scratch.last_mass_factor
    copy(scratch.mass_factor, last)
    if scaled:
        write_mass_factors(model, state.position, scratch.mass_factor)
    else:
        scratch.mass_factor[:] = 1.0
    key.step, key.damping, key.inertia = step, damping, inertia
    key.prescriptions, key.coarse, key.mass_scaled = changes, coarse, scaled
    mobility, moving, inverse_mass = scratch.mobility, model.moving, model.inverse_mass
    if not same:
        write_masses(model, scratch.mass)
    for index in range(len(moving)):
        node = moving[index]
        if same and factor[node] == last[node]:
            continue
        inverse = inverse_mass[node] / factor[node]
        if settings.integrator == Integrator.EXPLICIT:
            mobility[node] = inverse
        else:
            mobility[node] = inverse / inertia / (1.0 + step * inverse * damping * model.damping[node])
        if state.is_prescribed[node] == 1:
            mobility[node] = 0.0
        push = step / inertia * inverse
        shrink = 1.0 / (1.0 + push * (damping * inertia) * model.damping[node])
        for axis in range(3):
            scratch.push[3 * node + axis], scratch.shrink[3 * node + axis] = push, shrink


@kernel
def add_loads(world: World) -> None:
    """Add the external forces to scratch.force."""
    state, settings, force = world.state, world.settings, world.scratch.force
    add_weight(world.model, settings, world.scratch.mass, force)
    for index in range(state.status.loaded):
        node = state.loaded_node[index]
        for c in range(3):
            force[node, c] += state.nodal_force[node, c]
    add_tip_forces(state, settings, force)
