"""One tick: the same compiled function in the node's loop, in a test and in a replay.

inputs taken up -> anything touching or moving? -> local region or whole -> substeps
-> finite and bounded? -> wrenches
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from tissue_sim.handles import has
from tissue_sim.jit import chosen, kernel, part
from tissue_sim.model.contact_constraint import add_contact_impulses, carry_force, resolve_contacts
from tissue_sim.model.felt import report_wrenches
from tissue_sim.model.forces import elastic_forces
from tissue_sim.model.gravity import add_weight, is_out_of_balance
from tissue_sim.model.guard import check_cells, guard
from tissue_sim.model.inputs import unload_nodes
from tissue_sim.model.integrators import (
    explicit_euler,
    implicit_euler,
    predict,
    symplectic_euler,
    symplectic_euler_whole,
)
from tissue_sim.model.prescribed import count_prescribed, lead_prescribed
from tissue_sim.model.regions import (
    absorb_load,
    change_region,
    choose_region,
    damping_of,
    inertia_of,
    integrated_nodes,
    prepare_region,
    region_forces,
)
from tissue_sim.model.rest import find_back, rest_if_quiet, sleep_if_quiet
from tissue_sim.model.settings import Integrator
from tissue_sim.model.shiver import begin_look, end_look, is_looked_at
from tissue_sim.model.squeezed import has_stiff_cells
from tissue_sim.model.state import Region
from tissue_sim.model.tool_motion import (
    add_tip_forces,
    advance_held,
    couple_bodies,
    find_walls,
    follow_untouched,
    has_tip_force,
    keep_bodies,
)
from tissue_sim.model.watched import watch_contacts

CRUMPLED = 0.02  # share of cells inside out from which on a tick takes four times its substeps


@part
def tick(model: Any, state: Any, shapes: Any, settings: Any, scratch: Any) -> None:
    """Advance the organ by one tick of settings.tick_time seconds."""
    scratch.plan.handled = state.status.loaded > 0
    if not plan_tick(model, state, shapes, settings, scratch):
        return
    begin_tick(model, state, shapes, settings, scratch)
    for substep in range(scratch.plan.substeps):
        take_substep(model, state, shapes, settings, scratch, substep)
    end_tick(model, state, shapes, settings, scratch)


@part
def plan_tick(model: Any, state: Any, shapes: Any, settings: Any, scratch: Any) -> bool:
    """Whether there is anything to advance, and in scratch.plan how.

    scratch.plan.handled tells whether nodes were loaded before links and other organs did.
    """
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
            find_back(model, state, settings)
            check_cells(model, state, scratch)
            return False
        status.snapped = False
    prepare_region(model, state, settings, scratch)
    if status.region == Region.WHOLE:
        status.active = len(model.moving)

    scratch.impulse[:] = 0.0
    # The first forces tell how stiff the cells are.
    plan.whole = status.region == Region.WHOLE
    plan.implicit = steps_implicitly(model, state, settings, scratch)
    if plan.whole and not plan.implicit:
        whole_forces(model, state.position, settings, scratch)
    plan.regional = is_region_of_cells(model, state)
    if plan.regional:
        region_forces(model, state, settings, scratch, False)
    by_itself = settings.integrator == Integrator.IMPLICIT and not plan.implicit
    wanted = settings.region_substeps if by_itself or not plan.whole else settings.substeps
    factor = caution(model, state, plan.whole or plan.regional)
    plan.substeps = wanted * status.backoff * factor
    plan.looking = plan.whole and is_looked_at(model, state, plan.substeps) and factor == 1
    return True


@part
def begin_tick(model: Any, state: Any, shapes: Any, settings: Any, scratch: Any) -> None:
    """Make ready for the substeps of the plan."""
    status, plan = state.status, scratch.plan
    plan.eased = plan.substeps < status.substeps
    carry_force(state, status.substeps, plan.substeps)
    status.substeps = plan.substeps
    set_mobility(model, state, settings, settings.tick_time / plan.substeps, scratch, plan.implicit)
    watch_contacts(state, shapes, settings, scratch)


@part
def take_substep(model: Any, state: Any, shapes: Any, settings: Any, scratch: Any, substep: int) -> None:
    """Advance by one substep of the plan."""
    plan, first = scratch.plan, substep == 0
    substeps, implicit = plan.substeps, plan.implicit
    if plan.looking and substep == substeps - 1:
        begin_look(state, scratch)
    # The last one of a region tells more, and one that takes up momentum needs the forces where it is.
    known = first and (plan.whole or (plan.regional and substeps > 1)) and not (implicit and plan.eased)
    advance_substep(model, state, shapes, settings, scratch, substep, substeps, implicit, known, plan.eased and first)


@part
def end_tick(model: Any, state: Any, shapes: Any, settings: Any, scratch: Any) -> None:
    """Look at what the substeps made, hand out what is felt, and come to rest where nothing acts."""
    status, plan = state.status, scratch.plan
    if plan.looking:
        end_look(state, scratch)
    absorb_load(model, state, settings, scratch)
    guard(model, state, settings, scratch)
    check_cells(model, state, scratch)
    count_prescribed(state)
    report_wrenches(state, shapes, settings, scratch)
    change_region(model, state, shapes, settings, scratch)
    unload_nodes(state)
    status.alone = 0 if plan.handled or status.touching > 0 else status.alone + 1
    if status.alone > 0:
        rest_if_quiet(model, state, settings, scratch)
    elif not plan.forced and status.touching == 0:
        sleep_if_quiet(model, state, scratch)


def _or(kernel: Callable[..., Any], without: Callable[..., Any]) -> Callable[[Callable[..., Any]], Any]:
    """A function that is one kernel for models that are stepped implicitly, and another for the others."""
    return chosen(lambda model, *_: kernel if has(model, "factor") else without)


@kernel
def _if_sound(model: Any, state: Any, settings: Any, scratch: Any) -> bool:
    status = state.status
    if status.region != Region.WHOLE or status.turned > 0 or status.backoff > 1 or status.shivering > 0:
        return False
    predict(state.position, state.velocity, model.moving, settings.tick_time / settings.substeps, scratch.predicted)
    whole_forces(model, scratch.predicted, settings, scratch)
    return not has_stiff_cells(model)


@kernel
def _never(model: Any, state: Any, settings: Any, scratch: Any) -> bool:
    return False


@_or(_if_sound, _never)
def steps_implicitly(model: Any, state: Any, settings: Any, scratch: Any) -> Any:
    """True when this tick is one of the implicit integrator; then scratch.force has its first forces.

    Not in a local region; nor after a fault, while nodes shiver, or where cells are inside out or stiffer than its
    matrix knows, where its one step gains energy.
    """


@kernel
def _in_a_region(model: Any, state: Any) -> bool:
    return state.status.region != Region.WHOLE


@kernel
def _in_none(model: Any, state: Any) -> bool:
    return False


@chosen(lambda model, *_: _in_a_region if has(model, "tissue") and has(model, "adjacency") else _in_none)
def is_region_of_cells(model: Any, state: Any) -> Any:
    """True when this tick moves the cells around a load."""


@kernel
def caution(model: Any, state: Any, begun: bool) -> int:
    """Factor on the substeps while cells are squeezed or inside out, or nodes shiver: tissue is stiffer then.

    begun: the forces of this tick's first substep are known.
    """
    if state.status.turned == 0:
        return 2 if (begun and has_stiff_cells(model)) or state.status.shivering > 0 else 1
    return 4 if state.status.turned > CRUMPLED * len(model.cells) else 2


@kernel
def advance_substep(
    model: Any,
    state: Any,
    shapes: Any,
    settings: Any,
    scratch: Any,
    substep: int,
    substeps: int,
    implicit: bool,
    begun: bool,
    eased: bool,
) -> None:
    """Forces, integration and contact of one substep.

    begun: its elastic forces are known; eased: it is the first of a longer step than the last.
    """
    step = settings.tick_time / substeps
    couple_bodies(state, shapes, settings, scratch, step, 1.0 / (substeps - substep))
    if not begun:
        if state.status.region != Region.WHOLE:
            region_forces(model, state, settings, scratch, substep == substeps - 1)
        elif implicit and not eased:
            predict(state.position, state.velocity, model.moving, step, scratch.predicted)
            whole_forces(model, scratch.predicted, settings, scratch)
        else:
            whole_forces(model, state.position, settings, scratch)
    add_loads(model, state, settings, scratch.force)
    if implicit and eased:
        carry_momentum(model, state, scratch.force, step)
    integrate(model, state, shapes, settings, scratch, step, implicit)
    lead_prescribed(state, substep, substeps, step)
    pushed = has_taken_impulses(state, settings, implicit)
    state.status.touching = resolve_contacts(model, state, shapes, scratch.mobility, scratch, settings, step, pushed)
    keep_bodies(state, scratch)


@kernel
def whole_forces(model: Any, position: Any, settings: Any, scratch: Any) -> None:
    """Elastic forces of the whole organ at position (n, 3) m into scratch.force (n, 3) N."""
    scratch.force[:] = 0.0
    elastic_forces(model, position, scratch.force)
    scale_force(settings, scratch.force)


@kernel
def carry_momentum(model: Any, state: Any, force: Any, step: float) -> None:
    """Turn velocities into the force that gives them in a step, s: (M + h D + h^2 S) v+ = M v + h f.

    For an implicit step S adds mass. What moved without that must not have its speed with it: that is energy.
    """
    for index in range(len(model.moving)):
        node = model.moving[index]
        for c in range(3):
            force[node, c] += state.velocity[node, c] / (model.inverse_mass[node] * step)
            state.velocity[node, c] = 0.0


@kernel
def _implicitly(model: Any, state: Any, shapes: Any, settings: Any, scratch: Any, step: float) -> None:
    add_contact_impulses(state, shapes, scratch, 1.0 / step, scratch.force)
    implicit_euler(
        state.position,
        state.velocity,
        scratch.force,
        model.factor,
        settings.factor_slot,
        model.damping,
        settings.damping_scale,
        step,
        scratch.change,
    )


@kernel
def _not_at_all(model: Any, state: Any, shapes: Any, settings: Any, scratch: Any, step: float) -> None:
    """Never called."""


@_or(_implicitly, _not_at_all)
def integrate_implicitly(model: Any, state: Any, shapes: Any, settings: Any, scratch: Any, step: float) -> None:
    """Move the nodes by scratch.force and the last contact impulses for an implicit step, s."""


@kernel
def _implicit_mobility(model: Any, slot: int, node: int) -> float:
    return model.factor.mobility[slot, node]


@kernel
def _no_mobility(model: Any, slot: int, node: int) -> float:
    return 0.0


@_or(_implicit_mobility, _no_mobility)
def implicit_mobility(model: Any, slot: int, node: int) -> Any:
    """Velocity that an impulse gives a node within an implicit step, 1/kg."""


@kernel
def integrate(model: Any, state: Any, shapes: Any, settings: Any, scratch: Any, step: float, implicit: bool) -> None:
    """Move the nodes by scratch.force for a step, s."""
    if implicit:
        integrate_implicitly(model, state, shapes, settings, scratch, step)
        return
    scale, inertia = damping_of(state, settings), inertia_of(state, settings)
    if has_taken_impulses(state, settings, implicit):
        add_contact_impulses(state, shapes, scratch, 1.0 / step, scratch.force)
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
def has_taken_impulses(state: Any, settings: Any, implicit: bool) -> bool:
    """True when nodes are moved by the last contact impulses too: where these hold on, nothing is left to resolve."""
    return implicit or (settings.integrator != Integrator.EXPLICIT and state.status.region == Region.WHOLE)


@kernel
def set_mobility(model: Any, state: Any, settings: Any, step: float, scratch: Any, implicit: bool) -> None:
    """Velocity that an impulse gives each node within a substep, (n,) 1/kg, and what integration takes of its mass.

    Only when settings have changed. The damping is implicit, so it meets the contact's impulse too: 1 / (m + h d). With
    1/m alone a body at rest would press with a force short by h d/m. An implicit step brings the stiffness in.
    """
    slot = float(settings.factor_slot) if implicit else -1.0
    key, damping, scale = scratch.mobility_key, damping_of(state, settings), settings.stiffness_scale
    inertia = inertia_of(state, settings)
    changes, coarse = float(state.status.prescriptions), scratch.plan.coarse
    masses = 1.0 if coarse else 0.0
    same = key[0] == step and key[1] == damping and key[2] == slot and key[3] == scale
    if same and key[4] == inertia and key[5] == changes and key[6] == masses:
        return
    key[0], key[1], key[2], key[3], key[4], key[5] = step, damping, slot, scale, inertia, changes
    key[6] = masses
    mobility, moving, inverse_mass = scratch.mobility, model.moving, model.inverse_mass
    for index in range(len(moving)):
        node = moving[index]
        inverse = inverse_mass[node] / scratch.coarse[node] if coarse else inverse_mass[node]
        if implicit:
            mobility[node] = implicit_mobility(model, settings.factor_slot, node)
        elif settings.integrator == Integrator.EXPLICIT:
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
def scale_force(settings: Any, force: Any) -> None:
    """Scale the elastic forces by the tissue's stiffness."""
    scale = settings.stiffness_scale
    if scale != 1.0:
        for node in range(len(force)):
            for c in range(3):
                force[node, c] *= scale


@kernel
def add_loads(model: Any, state: Any, settings: Any, force: Any) -> None:
    """Add the external forces."""
    add_weight(model, settings, force)
    for index in range(state.status.loaded):
        node = state.loaded_node[index]
        for c in range(3):
            force[node, c] += state.nodal_force[node, c]
    add_tip_forces(state, settings, force)
