"""Several organs in one tick: carried by the breath, pulled by links, each then advanced as one alone is."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from tissue_sim.array_types import Floats
from tissue_sim.jit import kernel
from tissue_sim.model.breathing import Breath, breathe
from tissue_sim.model.links import Links, pull_links, wake_linked
from tissue_sim.model.tick import begin_tick, end_tick, plan_tick, take_substep

UNFELT = 1e-4  # m by which the acceleration of its frame bends an organ that sleeps on


class Carried(NamedTuple):
    """Where the breath has carried k organs."""

    breath: Breath
    share: Floats  # (2,) of its way, and 1/s
    moves: Floats  # (k,) how far each goes with it
    unfelt: Floats  # (k,) m/s^2 up to which none feels it
    gravity: Floats  # (k, 3) m/s^2, of each without it
    offset: Floats  # (k, 3) m
    speed: Floats  # (k, 3) m/s
    change: Floats  # (k, 3) m/s^2


class Together(NamedTuple):
    """What joins organs."""

    carried: Carried
    links: Links


def carried_with(breath: Breath, moves: Sequence[float], unfelt: Sequence[float], gravity: Floats) -> Carried:
    """Organs that go with a breath as far as `moves` (k,) says, breathed out; see Carried."""
    count = len(moves)

    def rows() -> Floats:
        return np.zeros((count, 3))

    given = np.array(moves, dtype=np.float64), np.array(unfelt, dtype=np.float64)
    return Carried(breath, np.zeros(2), *given, np.array(gravity, dtype=np.float64), rows(), rows(), rows())


@kernel
def tick_together(worlds: Any, joined: Any) -> None:
    """Advance several organs, a tuple of worlds, by one tick of the first one's settings."""
    step, carried, links = worlds[0].settings.tick_time, joined.carried, joined.links
    if carried.breath.period > 0.0:
        breathe(worlds, carried, step)
    linked = len(links.slack) > 0
    if linked:
        wake_linked(worlds, carried, links, step)
    substeps = plan_together(worlds, links, linked)
    for substep in range(substeps):
        if linked:
            pull_links(worlds, carried, links, step / substeps)
        for organ in range(len(worlds)):
            world = worlds[organ]
            if links.awake[organ] == 1 and substep < world.scratch.plan.substeps:
                take_substep(world.model, world.state, world.shapes, world.settings, world.scratch, substep)
    for organ in range(len(worlds)):
        world = worlds[organ]
        if links.awake[organ] == 1:
            end_tick(world.model, world.state, world.shapes, world.settings, world.scratch)


@kernel
def plan_together(worlds: Any, links: Any, linked: bool) -> int:
    """Plan the tick of every organ; returns the most substeps of any. Those that links join take as many each."""
    most = links.substeps[0] if linked else 0
    for organ in range(len(worlds)):
        world = worlds[organ]
        planned = plan_tick(world.model, world.state, world.shapes, world.settings, world.scratch)
        links.awake[organ] = 1 if planned else 0
        if planned:
            most = max(most, world.scratch.plan.substeps)
    for organ in range(len(worlds)):
        world = worlds[organ]
        if links.awake[organ] == 1:
            if linked:
                world.scratch.plan.substeps = most
            begin_tick(world.model, world.state, world.shapes, world.settings, world.scratch)
    return most
