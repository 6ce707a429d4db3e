"""Tick of all organs of a scene: the breath carries and links pull them, then each is advanced like a single organ."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from tissue_sim.array_types import Longs
from tissue_sim.jit import kernel
from tissue_sim.model.contact.haptic_output import divide_slew_limit
from tissue_sim.model.data.links import Links
from tissue_sim.model.data.world import World
from tissue_sim.model.stepping.breathing import Carried, breathe, set_frame_gravity
from tissue_sim.model.stepping.coarse_steps import Coarse, fit_coarse, plan_coarse, ratio_of
from tissue_sim.model.stepping.contact_pairs import OrganContacts
from tissue_sim.model.stepping.ligament_links import load_links, measure_links, pull_links
from tissue_sim.model.stepping.organ_contact import (
    apply_organ_contacts,
    resolve_organ_contacts,
    wake_touched_organs,
)
from tissue_sim.model.stepping.tick import begin_tick, end_tick, plan_tick, take_substep, tick
from tissue_sim.model.stepping.wake_threshold import WakeThreshold, apply_wake_threshold


class CoupledOrgans(NamedTuple):
    """Everything that joins organs."""

    carried: Carried
    links: Links
    pairs: OrganContacts
    threshold: WakeThreshold
    coarse: Coarse
    awake: Longs  # (k,) 1 for organs that this tick advances; before planning, for those that may be awake


@kernel
def uncouple(worlds: Sequence[World], joined: CoupledOrgans) -> None:
    """Return to the exhaled state without contact, and remove the breath's part of gravity, for organs at rest.

    Parameters
    ----------
    worlds : Sequence[World]
        Worlds of the organs; updated.
    joined : CoupledOrgans
        What joins the organs; updated.
    """
    carried = joined.carried
    joined.pairs.found[0] = 0
    carried.breath.time = carried.breath.target = carried.breath.fraction = carried.breath.speed = 0.0
    carried.fraction[:] = 0.0
    carried.speed[:] = 0.0
    carried.change[:] = 0.0
    for organ in range(len(worlds)):
        set_frame_gravity(worlds[organ].settings, carried, organ, 0.0)


@kernel
def tick_coupled(worlds: Sequence[World], joined: CoupledOrgans | None) -> None:
    """Advance organs, a row of worlds, by one tick of the first one's settings; joined: None for an organ alone."""
    if joined is None:
        tick(worlds[0])
        return
    step, carried, links, threshold = worlds[0].settings.tick_time, joined.carried, joined.links, joined.threshold
    pairs, awake, linked = joined.pairs, joined.awake, len(links.slack) > 0
    breathes = carried.breath.period > 0.0 or carried.breath.follows
    if breathes:
        breathe(worlds, carried, step)
    for organ in range(len(worlds)):
        status = worlds[organ].state.status
        worlds[organ].scratch.plan.handled = status.loaded > 0
        # Links and other organs don't act on an organ that recovers from a false rest shape: they might hold it there.
        awake[organ] = 0 if status.snapped else 1
    measure_links(worlds, carried, links, threshold, awake, step)
    wake_touched_organs(worlds, pairs, awake)
    if linked or breathes:
        apply_wake_threshold(worlds, carried, threshold, breathes)
        load_links(worlds, links, threshold)
    touching = pairs.found[0] > 0
    substeps = plan_coupled(worlds, joined, linked or touching)
    for substep in range(substeps):
        if linked:
            pull_links(worlds, carried, links, threshold, awake, step / substeps)
        if touching:
            apply_organ_contacts(worlds, pairs, awake)
        for organ in range(len(worlds)):
            world = worlds[organ]
            ratio = ratio_of(world.scratch.plan, substeps)
            own = substep // ratio
            if awake[organ] == 1 and substep == own * ratio and own < world.scratch.plan.substeps:
                take_substep(world, own)
        if touching:
            resolve_organ_contacts(worlds, carried, pairs, awake, step / substeps)
    handled = are_handled(worlds)
    divide_slew_limit(worlds, awake)
    for organ in range(len(worlds)):
        world = worlds[organ]
        if awake[organ] == 1:
            world.scratch.plan.handled = handled
            end_tick(world)


@kernel
def are_handled(worlds: Sequence[World]) -> bool:
    """Return whether a hand touches, pulls or moves any organ: through that organ it may also hold the others."""
    for organ in range(len(worlds)):
        world = worlds[organ]
        if world.scratch.plan.handled or world.state.status.touching > 0:
            return True
    return False


@kernel
def plan_coupled(worlds: Sequence[World], joined: CoupledOrgans, tied: bool) -> int:
    """Plan the tick of every organ; return the largest number of substeps of any organ, or that which links require.

    Organs that links or contact couple take the same number of substeps, except for those in coarse steps.
    """
    most, awake, coarse, added = 1, joined.awake, joined.coarse, joined.links.added[0]
    for organ in range(len(worlds)):
        world = worlds[organ]
        planned = plan_tick(world)
        awake[organ] = 1 if planned else 0
        if planned:
            plan_coarse(world, coarse, organ, added)
            least = 1 if world.scratch.plan.coarse else world.settings.least_substeps
            most = max(most, least, world.scratch.plan.substeps)
    for organ in range(len(worlds)):
        world = worlds[organ]
        if awake[organ] == 1:
            if world.scratch.plan.coarse:
                fit_coarse(world.scratch.plan, most)
                coarse.ticks[organ] += 1
            elif tied:
                world.scratch.plan.substeps = most
            begin_tick(world)
    return most
