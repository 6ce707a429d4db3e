"""Local region around a small load instead of the whole organ: its tick, and the change between the two.

The tick, the guard and the mailboxes access local regions only through this module and `moved_nodes`. A model without
any (`adjacency` is None) is compiled without them.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from tissue_sim.handles import has
from tissue_sim.jit import chosen, kernel, part
from tissue_sim.model.contact.constraint import add_contact_impulses
from tissue_sim.model.contact.tool_motion import freshness
from tissue_sim.model.data.arrays import copy, copy_nodes
from tissue_sim.model.data.model import Model
from tissue_sim.model.data.scratch import Scratch
from tissue_sim.model.data.settings import LocalRegion, Settings
from tissue_sim.model.data.state import Region, State
from tissue_sim.model.data.world import World
from tissue_sim.model.elasticity.gravity import is_heavy
from tissue_sim.model.regions import local_region, modal_region, mode_motion, static_load
from tissue_sim.model.regions.edge_gradient import edge_gradient
from tissue_sim.model.regions.moved_nodes import checked_nodes

# Fraction of the region force and of the largest edge gradient; below both, an organ that moved as a whole has a region
# again.
RETURN_FRACTION = 0.5
CALM_TIME = 0.2  # s for which both must be below
SLOWEST = 1.01  # longest tick of a modal region, relative to the time in which the far field follows a load
# Gradient of the displacement at a region's edge from which the whole model moves: up to there a modal region has an
# error of at most 5 %, wherever the load is (`bench region`).
MAX_EDGE_GRADIENT = 0.04
CALM_SPEED = 2e-3  # m/s; the modes of a new region start at rest


def _or(kernel: Callable[..., Any], without: Callable[..., Any]) -> Callable[[Callable[..., Any]], Any]:
    """Return a decorator: one kernel for models with a local region, and another for those without."""
    return chosen(lambda model, *_: kernel if has(model, "adjacency") else without)


@kernel
def _nothing(model: Model, state: State, settings: Settings, scratch: Scratch) -> None:
    """Do nothing, as the whole organ always moves."""


@kernel
def _choose(model: Model, state: State, settings: Settings, scratch: Scratch) -> None:
    if takes_whole(model, state, settings):
        state.status.region = Region.WHOLE
        return
    modal_region.forget_region(state)
    scratch.mode_move[:] = 0.0  # nodes that join the region are at rest
    state.status.calm = 0
    state.status.region = Region.FROZEN if settings.local_region == LocalRegion.FROZEN else Region.MODAL


@_or(_choose, _nothing)
def choose_region(model: Model, state: State, settings: Settings, scratch: Scratch) -> None:
    """Choose, when the organ wakes, a local region if ticks are short enough for it, otherwise the whole model.

    Parameters
    ----------
    model : Model
        Constants of the model.
    state : State
        State of the simulation; updated.
    settings : Settings
        Settings of the simulation.
    scratch : Scratch
        Working memory; updated.
    """


@kernel
def takes_whole(model: Model, state: State, settings: Settings) -> bool:
    """Return whether a local region is impossible, since its surroundings are linear about an unloaded, free shape.

    A modal region is also impossible if its surroundings would follow a load within a tick, that is in a jump.
    """
    if state.status.prescribed > 0 or is_heavy(model, settings):
        return True
    return settings.local_region >= LocalRegion.MODAL and settings.tick_time > SLOWEST * static_load.LOAD_TIME


@kernel
def _prepare(model: Model, state: State, settings: Settings, scratch: Scratch) -> None:
    status, count = state.status, state.count
    if status.region == Region.WHOLE:
        return
    modal = status.region == Region.MODAL
    if scratch.stale[0] == 1:
        local_region.list_nodes(state, scratch)
        collect(model, state, scratch)
        if modal:
            mode_motion.set_propagator(model, settings, scratch)
            mode_motion.project_load(state, scratch)
            mode_motion.set_mode_move(model, state, scratch)
    fresh = local_region.mark_loaded(state, scratch)
    if fresh > 0:
        nodes = status.region_nodes
        local_region.spread(
            model, state, scratch, fresh, modal_region.hops_of(model) if modal else local_region.FROZEN_HOPS
        )
        if modal:
            modal_region.place_joined(model, state, settings, scratch, nodes)
        collect(model, state, scratch)
    status.active = status.region_nodes
    if not modal:
        count.frozen_ticks += 1
        return
    if not modal_region.fits(state):
        leave_region(model, state, settings, scratch)
        return
    count.modal_ticks += 1
    mode_motion.advance_modes(model, state, settings, scratch)
    modal_region.place_boundary(model, state, settings, scratch)


@_or(_prepare, _nothing)
def prepare_region(model: Model, state: State, settings: Settings, scratch: Scratch) -> None:
    """Extend the local region to all loaded nodes before a tick, and move its edge; or switch to the whole model.

    Parameters
    ----------
    model : Model
        Constants of the model.
    state : State
        State of the simulation; updated.
    settings : Settings
        Settings of the simulation.
    scratch : Scratch
        Working memory; updated.
    """


@kernel
def _forces(model: Model, state: State, settings: Settings, scratch: Scratch, last: bool) -> None:
    local_region.clear_force(state, scratch)
    local_region.region_forces(model, state, scratch)
    if state.status.region == Region.MODAL and last:
        static_load.measure_drive(model, state, settings, scratch)
    local_region.region_return_forces(model, state, scratch)
    local_region.scale_force(state, scratch, settings.stiffness_scale)


@kernel
def _no_forces(model: Model, state: State, settings: Settings, scratch: Scratch, last: bool) -> None:
    """Do nothing; never called."""


@_or(_forces, _no_forces)
def region_forces(model: Model, state: State, settings: Settings, scratch: Scratch, last: bool) -> None:
    """Compute the elastic forces of the region's springs into scratch.force (n, 3) N.

    Parameters
    ----------
    model : Model
        Constants of the model.
    state : State
        State of the simulation; updated.
    settings : Settings
        Settings of the simulation.
    scratch : Scratch
        Working memory; updated.
    last : bool
        Whether it is the tick's last substep.
    """


@kernel
def _absorb(model: Model, state: State, settings: Settings, scratch: Scratch) -> None:
    if state.status.region == Region.MODAL:
        static_load.absorb_load(state, settings, scratch, static_load.load_fraction(model, settings))


@_or(_absorb, _nothing)
def absorb_load(model: Model, state: State, settings: Settings, scratch: Scratch) -> None:
    """Apply the tick's loads to the surroundings of the region, after the substeps.

    Parameters
    ----------
    model : Model
        Constants of the model.
    state : State
        State of the simulation; updated.
    settings : Settings
        Settings of the simulation.
    scratch : Scratch
        Working memory; updated.
    """


@kernel
def collect(model: Model, state: State, scratch: Scratch) -> None:
    """Make the region's lists from its nodes."""
    local_region.collect(model, state, scratch)
    if state.status.region == Region.MODAL:
        local_region.list_drive(state, scratch)
        if modal_region.fits(state):
            modal_region.gather_rows(model, state, scratch)
    scratch.stale[0] = 0


@kernel
def _change(world: World) -> None:
    model, state, settings, scratch = world.model, world.state, world.settings, world.scratch
    status = state.status
    if takes_whole(model, state, settings):
        if status.region != Region.WHOLE:
            leave_region(model, state, settings, scratch)
        return
    if settings.local_region == LocalRegion.MODAL:
        return
    load = total_load(state, settings)
    if status.region != Region.WHOLE:
        if load > settings.region_force or is_strongly_deformed(model, state, scratch, 1.0):
            leave_region(model, state, settings, scratch)
            status.calm = 0
        return
    if settings.local_region == LocalRegion.FROZEN or load > RETURN_FRACTION * settings.region_force or load == 0.0:
        status.calm = 0
        return
    status.calm += 1
    if status.calm * settings.tick_time >= CALM_TIME:
        status.calm = 0
        if is_nearly_at_rest(model, state):
            enter_region(world)


@kernel
def _no_change(world: World) -> None:
    """Do nothing: the whole organ always moves."""


@chosen(lambda world: _change if has(world, "model", "adjacency") else _no_change)
def change_region(world: World) -> None:
    """Switch to the whole model under a load that is too large for a region or bends the organ, and later back.

    Parameters
    ----------
    world : World
        Model, state, shapes, settings and working memory; updated.
    """


@kernel
def is_strongly_deformed(model: Model, state: State, scratch: Scratch, fraction: float) -> bool:
    """Return whether the gradient at a modal region's edge exceeds a fraction of its limit."""
    modal = state.status.region == Region.MODAL
    return modal and edge_gradient(model, state, scratch) > fraction * MAX_EDGE_GRADIENT


@kernel
def is_nearly_at_rest(model: Model, state: State) -> bool:
    """Return whether no node moves faster than a new region could follow."""
    for index in range(len(model.moving)):
        velocity = state.velocity[model.moving[index]]
        if velocity[0] ** 2 + velocity[1] ** 2 + velocity[2] ** 2 > CALM_SPEED**2:
            return False
    return True


@kernel
def leave_region(model: Model, state: State, settings: Settings, scratch: Scratch) -> None:
    """Move the whole model from now on, starting from the present shape of region and rest.

    Parameters
    ----------
    model : Model
        Constants of the model.
    state : State
        State of the simulation; updated.
    settings : Settings
        Settings of the simulation.
    scratch : Scratch
        Working memory; updated.
    """
    if state.status.region == Region.MODAL:
        update_outside(model, state, settings, scratch)
    state.status.region = Region.WHOLE


@kernel
def _show(model: Model, state: State, settings: Settings, scratch: Scratch) -> None:
    modal_region.place_outside(model, state, settings, scratch)


@_or(_show, _nothing)
def update_outside(model: Model, state: State, settings: Settings, scratch: Scratch) -> None:
    """Update the positions of nodes outside a modal region, which is done on request only.

    Parameters
    ----------
    model : Model
        Constants of the model.
    state : State
        State of the simulation; updated.
    settings : Settings
        Settings of the simulation.
    scratch : Scratch
        Working memory; updated.
    """


@kernel
def is_outside_current(state: State) -> bool:
    """Return whether all positions are up to date; otherwise update_outside computes them.

    Parameters
    ----------
    state : State
        State of the simulation.
    """
    return state.status.region != Region.MODAL or state.status.asleep


@kernel
def drop_region(state: State) -> None:
    """Move the whole model from now on, starting from the nodes' present positions.

    Parameters
    ----------
    state : State
        State of the simulation; updated.
    """
    state.status.region = Region.WHOLE
    modal_region.forget_region(state)


@kernel
def inertia_of(state: State, settings: Settings) -> float:
    """Return the factor on mass and damping of the moving nodes.

    Parameters
    ----------
    state : State
        State of the simulation.
    settings : Settings
        Settings of the simulation.
    """
    return settings.region_inertia if state.status.region == Region.MODAL else 1.0


@kernel
def damping_of(state: State, settings: Settings) -> float:
    """Return the factor on the damping; a modal region has at least the organ's own.

    The surroundings of a region follow the load slightly late, which excites undamped motion.

    Parameters
    ----------
    state : State
        State of the simulation.
    settings : Settings
        Settings of the simulation.
    """
    scale = settings.damping_scale
    return max(scale, 1.0) if state.status.region == Region.MODAL else scale


@kernel
def restore_shape(model: Model, state: State, scratch: Scratch) -> None:
    """Return to the last valid shape, without speed; outside a modal region it is the one computed last.

    Parameters
    ----------
    model : Model
        Constants of the model.
    state : State
        State of the simulation; updated.
    scratch : Scratch
        Working memory.
    """
    if state.status.region == Region.MODAL:
        copy_nodes(state.good_position, state.position, checked_nodes(model, state, scratch))
        copy(state.position, state.good_position)
        drop_region(state)
    else:
        copy(state.good_position, state.position)
    state.velocity[:] = 0.0


@part
def enter_region(world: World) -> None:
    """Move a modal region around the load from now on; the rest of the organ continues from its present shape."""
    model, state, settings, scratch = world.model, world.state, world.settings, world.scratch
    modal_region.forget_region(state)
    state.status.region = Region.MODAL
    fresh = local_region.mark_loaded(state, scratch)
    local_region.spread(model, state, scratch, fresh, modal_region.hops_of(model))
    collect(model, state, scratch)
    if not modal_region.fits(state):
        state.status.region = Region.WHOLE
        return
    add_contact_impulses(state, world.shapes, scratch, state.status.substeps, state.contact_impulse)
    local_region.clear_force(state, scratch)
    local_region.region_forces(model, state, scratch)
    static_load.measure_drive(model, state, settings, scratch)
    static_load.absorb_load(state, settings, scratch, 1.0)
    modal_region.keep_offset(model, state, settings, scratch)
    modal_region.move_edge(model, state, settings, scratch)
    if is_strongly_deformed(model, state, scratch, RETURN_FRACTION):
        drop_region(state)


@kernel
def total_load(state: State, settings: Settings) -> float:
    """Return the sum of the magnitudes of contact, nodal and external tool forces, N."""
    load = 0.0
    for index in range(state.status.loaded):
        force = state.nodal_force[state.loaded_node[index]]
        load += math.sqrt(force[0] ** 2 + force[1] ** 2 + force[2] ** 2)
    for body in range(len(state.wrench)):
        load += math.sqrt(state.wrench[body, 0] ** 2 + state.wrench[body, 1] ** 2 + state.wrench[body, 2] ** 2)
        if state.contacts.tip_node[body, 0] >= 0:
            force = state.body_force[body]
            fresh = freshness(state.bodies[body].force_age, settings)
            load += fresh * math.sqrt(force[0] ** 2 + force[1] ** 2 + force[2] ** 2)
    return load
