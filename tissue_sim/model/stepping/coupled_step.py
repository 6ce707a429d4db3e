"""The organs of a scene in one tick: carried by the breath, pulled by links, each then advanced as one alone is."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from tissue_sim.array_types import Floats, Longs
from tissue_sim.jit import kernel
from tissue_sim.model.data.records import words_of
from tissue_sim.model.stepping.breathing import Breath, breathe, weigh
from tissue_sim.model.stepping.coarse_steps import Coarse, fit_coarse, plan_coarse, ratio_of
from tissue_sim.model.stepping.ligament_links import Links, load_links, measure_links, pull_links
from tissue_sim.model.stepping.organ_contact import (
    OrganContacts,
    apply_organ_contacts,
    resolve_organ_contacts,
    wake_touched_organs,
)
from tissue_sim.model.stepping.tick import begin_tick, end_tick, plan_tick, take_substep, tick
from tissue_sim.model.stepping.wake_threshold import WakeThreshold, apply_wake_threshold


class Carried(NamedTuple):
    """How breathing moves k organs; see `state.carried`."""

    breath: Breath
    breath_words: Longs  # memory of the breath
    share: Floats  # (2,) fraction of the breath's way, and its rate, 1/s
    moves: Floats  # (k,) fraction of the way that each follows
    gravity: Floats  # (k, 3) m/s^2, of each without the breath
    speed: Floats  # (k, 3) m/s
    change: Floats  # (k, 3) m/s^2


class Together(NamedTuple):
    """Everything that joins organs."""

    carried: Carried
    links: Links
    pairs: OrganContacts
    unfelt: WakeThreshold
    coarse: Coarse
    awake: Longs  # (k,) 1 for organs that this tick advances; before planning, for those that it may


def moves_with_frame(breath: Breath, moves: Sequence[float], gravity: Floats) -> Carried:
    """Return organs that follow a breath by the fractions `moves` (k,), breathed out; see Carried."""
    count = len(moves)

    def rows() -> Floats:
        return np.zeros((count, 3))

    given = np.array(moves, dtype=np.float64), np.array(gravity, dtype=np.float64)
    return Carried(breath, words_of(breath), np.zeros(2), *given, rows(), rows())


@kernel
def let_go(worlds: Any, joined: Any) -> None:
    """Return to the breathed-out state without contact, and undo the breath's part of gravity, for organs at rest.

    Parameters
    ----------
    worlds : Any
        Worlds of the organs; updated.
    joined : Any
        What joins the organs; updated.
    """
    carried = joined.carried
    joined.pairs.found[0] = 0
    carried.breath.time = carried.breath.told = carried.breath.share = carried.breath.speed = 0.0
    carried.share[:] = 0.0
    carried.speed[:] = 0.0
    carried.change[:] = 0.0
    for organ in range(len(worlds)):
        weigh(worlds[organ].settings, carried, organ, 0.0)


@kernel
def tick_coupled(worlds: Any, joined: Any) -> None:
    """Advance organs, a row of worlds, by one tick of the first one's settings; joined: None for an organ alone."""
    if joined is None:
        tick(worlds[0])
        return
    step, carried, links, unfelt = worlds[0].settings.tick_time, joined.carried, joined.links, joined.unfelt
    pairs, awake, linked = joined.pairs, joined.awake, len(links.slack) > 0
    breathes = carried.breath.period > 0.0 or carried.breath.follows
    if breathes:
        breathe(worlds, carried, step)
    for organ in range(len(worlds)):
        status = worlds[organ].state.status
        worlds[organ].scratch.plan.handled = status.loaded > 0
        # Links and other organs release an organ that recovers from a false rest shape: they would hold it there.
        awake[organ] = 0 if status.snapped else 1
    measure_links(worlds, carried, links, unfelt, awake, step)
    wake_touched_organs(worlds, pairs, awake)
    if linked or breathes:
        apply_wake_threshold(worlds, carried, unfelt, breathes)
        load_links(worlds, links, unfelt)
    touching = pairs.found[0] > 0
    substeps = plan_coupled(worlds, joined, linked or touching)
    for substep in range(substeps):
        if linked:
            pull_links(worlds, carried, links, unfelt, awake, step / substeps)
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
    for organ in range(len(worlds)):
        world = worlds[organ]
        if awake[organ] == 1:
            world.scratch.plan.handled = handled
            end_tick(world)


@kernel
def are_handled(worlds: Any) -> bool:
    """Return whether a hand touches, pulls or moves any organ: through it, it may hold the others as they are."""
    for organ in range(len(worlds)):
        world = worlds[organ]
        if world.scratch.plan.handled or world.state.status.touching > 0:
            return True
    return False


@kernel
def plan_coupled(worlds: Any, joined: Any, tied: bool) -> int:
    """Plan the tick of every organ; return the most substeps of any, or those that links require.

    Organs that links or contact tie to each other take the same number each, except for those in coarse steps.
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
