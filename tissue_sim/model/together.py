"""Several organs in one tick: carried by the breath, pulled by links, each then advanced as one alone is."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from tissue_sim.array_types import Floats, Longs
from tissue_sim.errors import UserError
from tissue_sim.handles import handle, row
from tissue_sim.jit import kernel
from tissue_sim.model.breathing import Breath, breathe, weigh
from tissue_sim.model.coarse import Coarse, allow_coarse, fit_coarse, no_coarse, plan_coarse, ratio_of
from tissue_sim.model.felt import sum_felt
from tissue_sim.model.links import Links, least_substeps, load_links, measure_links, pull_links
from tissue_sim.model.pairs import MOST_ORGANS, Pairs, PairSet, press_pairs, resolve_pairs, take_pairs, wake_touched
from tissue_sim.model.records import words_of
from tissue_sim.model.settings import Settings
from tissue_sim.model.simulation import Simulation
from tissue_sim.model.tick import begin_tick, end_tick, plan_tick, take_substep
from tissue_sim.model.unfelt import UNFELT, Unfelt, share_loads, unfelt_by


class Carried(NamedTuple):
    """How the breath carries k organs; see `state.carried`."""

    breath: Breath
    breath_words: Longs  # which it views
    share: Floats  # (2,) of its way, and 1/s
    moves: Floats  # (k,) how far each goes with it
    gravity: Floats  # (k, 3) m/s^2, of each without it
    speed: Floats  # (k, 3) m/s
    change: Floats  # (k, 3) m/s^2


class Together(NamedTuple):
    """What joins organs."""

    carried: Carried
    links: Links
    pairs: Pairs
    unfelt: Unfelt
    coarse: Coarse
    awake: Longs  # (k,) 1 for organs that this tick advances; until it is planned, for those that it may


class Joined:
    """Simulations that are advanced together.

    links between them; pairs where they touch, found by others; breath, and how far each goes with it, (k,), or nothing
    where none does. unfelt: m that an organ may lack of what links and the breath do to it, see `unfelt`; 0: nothing.
    Raises UserError where simulations don't fit together. worlds and handle are what `tick_together` takes.
    """

    def __init__(
        self,
        simulations: Sequence[Simulation],
        links: Links,
        pairs: Pairs,
        breath: Breath,
        moves: Sequence[float] = (),
        unfelt: float = UNFELT,
    ) -> None:
        self.simulations, self.links, self.pairs = list(simulations), links, pairs
        if len(self.simulations) > MOST_ORGANS:
            raise UserError(f"{len(self.simulations)} organs are joined; wanted: {MOST_ORGANS} at the most")
        if len({(one.rate, one.variant, one.local_region, one.integrator, one.implied) for one in simulations}) > 1:
            raise UserError("organs of one scene have one rate, model, local region, integrator and return target")
        if self.simulations[0].implied:
            raise UserError("organs of one scene have return target rest, not implied")
        moves = list(moves) or [0.0] * len(self.simulations)
        if len(moves) != len(self.simulations):
            raise UserError(
                f"how far organs go with the breath: {len(moves)} numbers for {len(self.simulations)} organs"
            )
        gravity = np.array([gravity_of(one.settings) for one in self.simulations])
        self.carried = carried_with(breath, moves, gravity)
        self.unfelt = unfelt_by(self.simulations, links, np.outer(moves, [breath.x, breath.y, breath.z]), unfelt)
        self.worlds = row([one.world for one in self.simulations])
        self.coarse = no_coarse(len(moves))
        awake = np.zeros(len(moves), dtype=np.int64)
        self.handle = handle(Together(self.carried, links, pairs, self.unfelt, self.coarse, awake))
        self.set_substeps()
        if len(moves) > 1 and unfelt > 0.0:
            for organ, one in enumerate(self.simulations):
                allow_coarse(self.coarse, organ, one, float(links.added[0]))

    def step(self) -> None:
        """Advance all by one tick."""
        tick_together(self.worlds, self.handle)

    @property
    def wrench(self) -> Floats:
        """What every body of the tools feels of all organs, (b, 6) N and N m about its origin."""
        wrench = np.zeros_like(self.simulations[0].state.wrench)
        sum_felt(self.worlds, wrench)
        return wrench

    def set_substeps(self) -> None:
        """Work out the substeps of each, and those that links ask for, after stiffness, damping or the rate changed."""
        for one in self.simulations:
            one.set_substeps()
        least = least_substeps(self.links, fastest(self.simulations), float(self.simulations[0].settings.tick_time))
        for one in self.simulations:
            one.settings.least_substeps = least

    def take_pairs(self, found: PairSet) -> None:
        """Take up where organs touch each other."""
        take_pairs(self.pairs, found)

    def take_settings(self, organ: int, settings: Settings) -> None:
        """Use settings of an organ that were worked out before, with its gravity less what the breath makes of it."""
        self.simulations[organ].take_settings(settings)
        self.carried.gravity[organ] = gravity_of(settings)

    def note_gravity(self) -> None:
        """Take up gravity that simulations were given: what organs weigh without the breath."""
        for one, gravity in zip(self.simulations, self.carried.gravity, strict=True):
            gravity[:] = gravity_of(one.settings)

    def tell_breath(self, share: float) -> None:
        """Where a breath is to be that follows what it is told, as a share of its way."""
        self.carried.breath.told = share

    def restore(self, breath: Breath, found: PairSet, pressed: Floats, held: Floats) -> None:
        """Go on from a breath, and from pairs that press and hold with so many N (p,), (p, 3)."""
        count = int(found.found[0])
        self.pairs.found[0] = 0
        self.take_pairs(found)
        self.pairs.pressed[:count], self.pairs.held[:count] = pressed[:count], held[:count]
        words_of(self.carried.breath)[:] = words_of(breath)

    def reset(self) -> None:
        """Breathed out, untouched by each other; simulations are reset by themselves."""
        let_go(self.worlds, self.handle)


def gravity_of(settings: Settings) -> tuple[float, float, float]:
    """Gravity, m/s^2."""
    return settings.gravity_x, settings.gravity_y, settings.gravity_z


def fastest(simulations: Sequence[Simulation]) -> float:
    """The largest angular frequency of any, rad/s."""
    return max(one.frequency * math.sqrt(one.settings.stiffness_scale) for one in simulations)


def carried_with(breath: Breath, moves: Sequence[float], gravity: Floats) -> Carried:
    """Organs that go with a breath as far as `moves` (k,) says, breathed out; see Carried."""
    count = len(moves)

    def rows() -> Floats:
        return np.zeros((count, 3))

    given = np.array(moves, dtype=np.float64), np.array(gravity, dtype=np.float64)
    return Carried(breath, words_of(breath), np.zeros(2), *given, rows(), rows())


@kernel
def let_go(worlds: Any, joined: Any) -> None:
    """Breathed out, untouched by each other, without what the breath did to gravity: for organs at rest."""
    carried = joined.carried
    joined.pairs.found[0] = 0
    carried.breath.time = carried.breath.told = carried.breath.share = carried.breath.speed = 0.0
    carried.share[:] = 0.0
    carried.speed[:] = 0.0
    carried.change[:] = 0.0
    for organ in range(len(worlds)):
        weigh(worlds[organ].settings, carried, organ, 0.0)


@kernel
def tick_together(worlds: Any, joined: Any) -> None:
    """Advance several organs, a row of worlds, by one tick of the first one's settings."""
    step, carried, links, unfelt = worlds[0].settings.tick_time, joined.carried, joined.links, joined.unfelt
    pairs, awake, linked = joined.pairs, joined.awake, len(links.slack) > 0
    breathes = carried.breath.period > 0.0 or carried.breath.follows
    if breathes:
        breathe(worlds, carried, step)
    for organ in range(len(worlds)):
        status = worlds[organ].state.status
        worlds[organ].scratch.plan.handled = status.loaded > 0
        # What is led back from a false rest shape is let go of by links and other organs, which hold it there.
        awake[organ] = 0 if status.snapped else 1
    measure_links(worlds, carried, links, unfelt, awake, step)
    wake_touched(worlds, pairs, awake)
    if linked or breathes:
        share_loads(worlds, carried, unfelt, breathes)
        load_links(worlds, links, unfelt)
    touching = pairs.found[0] > 0
    substeps = plan_together(worlds, joined, linked or touching)
    for substep in range(substeps):
        if linked:
            pull_links(worlds, carried, links, unfelt, awake, step / substeps)
        if touching:
            press_pairs(worlds, pairs, awake)
        for organ in range(len(worlds)):
            world = worlds[organ]
            ratio = ratio_of(world.scratch.plan, substeps)
            own = substep // ratio
            if awake[organ] == 1 and substep == own * ratio and own < world.scratch.plan.substeps:
                take_substep(world.model, world.state, world.shapes, world.settings, world.scratch, own)
        if touching:
            resolve_pairs(worlds, carried, pairs, awake, step / substeps)
    handled = are_handled(worlds)
    for organ in range(len(worlds)):
        world = worlds[organ]
        if awake[organ] == 1:
            world.scratch.plan.handled = handled
            end_tick(world.model, world.state, world.shapes, world.settings, world.scratch)


@kernel
def are_handled(worlds: Any) -> bool:
    """True when a hand touches, pulls or leads any organ: through it, it may hold the others as they are."""
    for organ in range(len(worlds)):
        world = worlds[organ]
        if world.scratch.plan.handled or world.state.status.touching > 0:
            return True
    return False


@kernel
def plan_together(worlds: Any, joined: Any, tied: bool) -> int:
    """Plan the tick of every organ; returns the most substeps of any, or those that links ask for.

    Those that are tied by links or touch take as many each, but for those in coarse steps.
    """
    most, awake, coarse, added = 1, joined.awake, joined.coarse, joined.links.added[0]
    for organ in range(len(worlds)):
        world = worlds[organ]
        planned = plan_tick(world.model, world.state, world.shapes, world.settings, world.scratch)
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
            begin_tick(world.model, world.state, world.shapes, world.settings, world.scratch)
    return most
