"""Which nodes move: the whole organ, or a local region around a small load, and the change from one to the other."""

from __future__ import annotations

import math
from typing import Any

from tissue_sim.jit import kernel, part
from tissue_sim.model import local_region, modal_region
from tissue_sim.model.contact_constraint import add_contact_impulses
from tissue_sim.model.settings import LocalRegion
from tissue_sim.model.state import Region
from tissue_sim.model.tool_motion import freshness

RETURN_SHARE = 0.5  # of the region force: under it, an organ that moved as a whole takes a region again
CALM_TIME = 0.2  # s for which it has to be
SLOWEST = 1.01  # of the time in which the far field takes up a load: the longest tick that a modal region bears
CALM_SPEED = 2e-3  # m/s; the modes of a new region start at rest


@kernel
def choose_region(state: Any, settings: Any) -> None:
    """On waking: a local region if asked for and ticks are short enough for it, else the whole model."""
    if settings.local_region == LocalRegion.OFF or is_slow(settings):
        state.status.region = Region.WHOLE
        return
    modal_region.forget_region(state)
    state.status.calm = 0
    state.status.region = Region.FROZEN if settings.local_region == LocalRegion.FROZEN else Region.MODAL


@kernel
def is_slow(settings: Any) -> bool:
    """True where a modal region is asked for, but its surroundings would take up a load within a tick: a jump."""
    return settings.local_region >= LocalRegion.MODAL and settings.tick_time > SLOWEST * modal_region.LOAD_TIME


@kernel
def prepare_region(model: Any, state: Any, settings: Any, scratch: Any) -> None:
    """Grow the local region to what is loaded, and move its edge."""
    status, count = state.status, state.count
    modal = status.region == Region.MODAL
    if scratch.stale[0] == 1:
        local_region.list_nodes(state, scratch)
        collect(model, state, scratch)
        if modal:
            modal_region.set_propagator(model, settings, scratch)
            modal_region.project_load(state, scratch)
            modal_region.set_mode_move(model, state, scratch)
    fresh = local_region.mark_loaded(state, scratch)
    if fresh > 0:
        nodes = status.region_nodes
        local_region.spread(
            model, state, scratch, fresh, local_region.MODAL_HOPS if modal else local_region.FROZEN_HOPS
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
    modal_region.advance_modes(model, state, settings, scratch)
    modal_region.place_boundary(model, state, settings, scratch)


@kernel
def collect(model: Any, state: Any, scratch: Any) -> None:
    """Make the region's lists from its nodes."""
    local_region.collect(model, state, scratch)
    if state.status.region == Region.MODAL:
        modal_region.list_drive(state, scratch)
        if modal_region.fits(state):
            modal_region.gather_rows(model, state, scratch)
    scratch.stale[0] = 0


@part
def change_region(model: Any, state: Any, shapes: Any, settings: Any, scratch: Any) -> None:
    """Under a load too large for a region the whole model moves; under a small one it takes a region again."""
    status = state.status
    if is_slow(settings):
        if status.region != Region.WHOLE:
            leave_region(model, state, settings, scratch)
        return
    if settings.local_region == LocalRegion.MODAL:
        return
    load = total_load(state, settings)
    if status.region != Region.WHOLE:
        if load > settings.region_force:
            leave_region(model, state, settings, scratch)
            status.calm = 0
        return
    if settings.local_region == LocalRegion.FROZEN or load > RETURN_SHARE * settings.region_force or load == 0.0:
        status.calm = 0
        return
    status.calm += 1
    if status.calm * settings.tick_time >= CALM_TIME:
        status.calm = 0
        if is_calm(model, state):
            enter_region(model, state, shapes, settings, scratch)


@kernel
def is_calm(model: Any, state: Any) -> bool:
    """True when no node moves faster than a new region could take up."""
    for index in range(len(model.moving)):
        velocity = state.velocity[model.moving[index]]
        if velocity[0] ** 2 + velocity[1] ** 2 + velocity[2] ** 2 > CALM_SPEED**2:
            return False
    return True


@kernel
def leave_region(model: Any, state: Any, settings: Any, scratch: Any) -> None:
    """From here on the whole model moves, from where the region and the rest of the organ are."""
    if state.status.region == Region.MODAL:
        modal_region.place_outside(model, state, settings, scratch)
    state.status.region = Region.WHOLE


@part
def enter_region(model: Any, state: Any, shapes: Any, settings: Any, scratch: Any) -> None:
    """From here on a modal region around the load moves, and the rest of the organ from where it is."""
    modal_region.forget_region(state)
    state.status.region = Region.MODAL
    fresh = local_region.mark_loaded(state, scratch)
    local_region.spread(model, state, scratch, fresh, local_region.MODAL_HOPS)
    collect(model, state, scratch)
    if not modal_region.fits(state):
        state.status.region = Region.WHOLE
        return
    add_contact_impulses(state, shapes, scratch, state.status.substeps, state.contact_impulse)
    local_region.clear_force(state, scratch)
    local_region.region_forces(model, state, scratch)
    modal_region.measure_drive(state, settings, scratch)
    modal_region.absorb_load(state, settings, scratch, 1.0)
    modal_region.keep_offset(model, state, settings, scratch)


@kernel
def total_load(state: Any, settings: Any) -> float:
    """Sum of the magnitudes of contact, nodal and external tool forces, N."""
    load = 0.0
    for index in range(state.status.loaded):
        force = state.nodal_force[state.loaded_node[index]]
        load += math.sqrt(force[0] ** 2 + force[1] ** 2 + force[2] ** 2)
    for tool in range(len(state.wrench)):
        load += math.sqrt(state.wrench[tool, 0] ** 2 + state.wrench[tool, 1] ** 2 + state.wrench[tool, 2] ** 2)
        if state.contacts.tip_node[tool, 0] >= 0:
            force = state.tool_force[tool]
            fresh = freshness(state.tools[tool].force_age, settings)
            load += fresh * math.sqrt(force[0] ** 2 + force[1] ** 2 + force[2] ** 2)
    return load
