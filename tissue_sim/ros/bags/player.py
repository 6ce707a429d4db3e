"""Replay of a recording, tick by tick and without DDS."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from tissue_sim import progress
from tissue_sim.array_types import Floats
from tissue_sim.contact.tools import ToolSet
from tissue_sim.errors import UserError
from tissue_sim.organ.organ import Organ
from tissue_sim.ros.bags.comparison import Shown
from tissue_sim.ros.bags.joined_player import JoinedPlayer
from tissue_sim.ros.bags.organ_player import OrganPlayer, ToolInputs
from tissue_sim.ros.bags.recording import Recording, tools_of


@dataclass
class Replayed:
    """What a replay shows at the ticks that were requested, and how much it applied."""

    wanted: Shown  # of the requested ticks, those that the replay visited
    shown: Shown
    ticks: int = 0
    inputs: int = 0
    contact_sets: int = 0


def replay(recording: Recording, organ: Organ | None = None, wanted: Shown | None = None) -> Replayed:
    """Feed the recorded inputs at the ticks that applied them.

    organ: organ to use instead of the recorded one; wanted: ticks and tools of the results (by default those that the
    bag shows). Raises UserError when another organ is given for a scene.
    """
    if organ is not None and recording.is_scene:
        raise UserError("another organ can replace only the one of a single-organ bag, and this one contains a scene")
    with progress.task("making the model"):
        organs = [organ] if organ is not None else [one.organ() for one in recording.organs]
        player = Player(recording, organs)
    return player.run(recording.shown() if wanted is None else wanted)


class Player:
    """Simulations that apply what a recording's journal names; they run once."""

    def __init__(self, recording: Recording, organs: Sequence[Organ]) -> None:
        self.recording = recording
        self.tools = ToolSet(tools_of(recording.config))
        inputs = ToolInputs.of(recording, self.tools)
        self.organs = [
            OrganPlayer(own, organ, recording.config, self.tools, inputs)
            for own, organ in zip(recording.organs, organs, strict=True)
        ]
        self.joined = JoinedPlayer(recording.joined, self.organs)
        self.tick = self.organs[0].tick
        take_settings = self.joined.joined.take_settings
        self._take_settings = [partial(take_settings, number) for number in range(len(self.organs))]

    def _wrench(self, tool: int, recorded: Floats) -> Floats:
        """Return a tool's wrench, (6,); of a gripper only the force, as the journal lacks the pose of its torque."""
        bodies = self.tools.bodies[tool]
        of_bodies = self.joined.joined.wrench
        if len(bodies) == 1:
            return np.asarray(of_bodies[bodies[0]])
        return np.concatenate([of_bodies[bodies, :3].sum(axis=0), recorded[3:]])

    def run(self, wanted: Shown, watch: Callable[[int], None] | None = None) -> Replayed:
        """Go through the recording, and return what is wanted of its ticks.

        wanted: ticks and tools of the results; watch: called after each tick.
        """
        last = max(self.tick, self.recording.last_tick)
        wanted = wanted.within(self.tick + 1, last)
        shown = Shown(
            wanted.tools,
            wanted.wrench_ticks,
            [np.zeros_like(wrenches) for wrenches in wanted.wrenches],
            wanted.surface_ticks,
            [np.zeros_like(surfaces) for surfaces in wanted.surfaces],
        )
        wrench_at, surface_at = _by_tick(wanted.wrench_ticks), _by_tick(wanted.surface_ticks)
        for one, surfaces in zip(self.organs, wanted.surfaces, strict=True):
            if len(surfaces) and surfaces.shape[1] != one.n_surface:
                raise UserError(
                    f"the bag's surfaces have {surfaces.shape[1]} points, but the organ has {one.n_surface}: it is"
                    " another organ"
                )
        result = Replayed(wanted, shown)
        for one, take_settings in zip(self.organs, self._take_settings, strict=True):
            one.begin(take_settings)
        for tick in progress.steps(range(self.tick + 1, last + 1), "ticks"):
            self._take(tick, result)
            result.ticks += 1
            if watch is not None:
                watch(tick)
            for one in self.organs:
                one.keep(tick)
            for tool, index in wrench_at.get(tick, ()):
                shown.wrenches[tool][index] = self._wrench(tool, wanted.wrenches[tool][index])
            for organ, index in surface_at.get(tick, ()):
                shown.surfaces[organ][index] = self.organs[organ].surface()
        return result

    def _take(self, tick: int, result: Replayed) -> None:
        """Apply what is new, in the order of the node's loop, and advance by a tick."""
        was_reset = False
        for number, one in enumerate(self.organs):
            made = one.cut(tick)
            if made is not None:
                joined = self.joined.joined
                plan = joined.plan_exchange(number, made)._replace(version=one.version)
                made.take_settings(joined.simulations[number].settings)  # the loop goes on with its own
                joined.exchange(number, made, plan)
        for one, take_settings in zip(self.organs, self._take_settings, strict=True):
            taken = one.take(tick, take_settings)
            if taken is not None:
                result.inputs += 1
                result.contact_sets += taken.contact_set
                was_reset |= taken.reset
        self.joined.step(tick, was_reset)


def _by_tick(ticks: Sequence[np.ndarray]) -> dict[int, list[tuple[int, int]]]:
    """Return which of several lists has a tick, and at which index: a slow loop may be shown twice in a tick."""
    found: dict[int, list[tuple[int, int]]] = defaultdict(list)
    for which, own in enumerate(ticks):
        for index, tick in enumerate(own.tolist()):
            found[tick].append((which, index))
    return found
