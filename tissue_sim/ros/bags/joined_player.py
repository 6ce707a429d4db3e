"""What joins the organs of a recording in its replay."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

from tissue_sim.array_types import Floats
from tissue_sim.contact.organ_contact_finder import OrganContactFinder
from tissue_sim.errors import UserError
from tissue_sim.model.stepping.contact_pairs import OrganContactSet
from tissue_sim.ros.bags.joined_recording import JoinedRecording
from tissue_sim.ros.bags.organ_player import OrganPlayer


class JoinedPlayer:
    """Player that advances organs together, and applies where they touch."""

    def __init__(self, recording: JoinedRecording, organs: Sequence[OrganPlayer]) -> None:
        self._recording, self._organs = recording, list(organs)
        self.joined = recording.join([one.simulation for one in organs])
        rows = recording.journal
        first = organs[0].tick
        self._taken_at = {int(row["tick"]): row for row in rows["joined"]}
        before = [tick for tick in self._taken_at if tick <= first]
        if not before:
            raise UserError("the bag doesn't record which inputs its state had used; its recording lost messages")
        self._newest = self._taken_at[max(before)]
        self._fractions = dict(
            zip(rows["respiration"]["respiration"].tolist(), rows["respiration"]["share"].tolist(), strict=True)
        )
        self._found_from = dict(zip(rows["pairs"]["pairs"].tolist(), rows["pair_ticks"].tolist(), strict=True))
        self._needed = [set(ticks) for ticks in rows["pair_ticks"].T.tolist()]
        self._kept: list[dict[int, Floats]] = [{} for _ in organs]
        self._surfaces = rows["pair_surfaces"].tolist()  # after cuts, on which pairs were not looked for yet

    @cached_property
    def _finder(self) -> OrganContactFinder:
        return OrganContactFinder([one.simulation.organ for one in self._organs])

    def step(self, tick: int, was_reset: bool) -> None:
        """Advance by a tick, after every organ has applied its own inputs.

        was_reset: whether it was reset in this tick.
        """
        if was_reset:
            self.joined.reset()
        row, before = self._taken_at.get(tick, self._newest), self._newest
        if row["respiration"] != before["respiration"]:
            self.joined.set_breathing(self._fraction(int(row["respiration"])))
        if row["pairs"] != before["pairs"]:
            self.joined.take_pairs(self._pair_set(int(row["pairs"])))
        self._newest = row
        self.joined.step()
        for one, needed, kept in zip(self._organs, self._needed, self._kept, strict=True):
            if tick in needed:
                kept[tick] = one.simulation.positions + one.simulation.state.carried

    def _fraction(self, sequence: int) -> float:
        if sequence not in self._fractions:
            raise UserError(f"the bag has no respiration number {sequence}; its recording lost messages")
        return float(self._fractions[sequence])

    def _pair_set(self, sequence: int) -> OrganContactSet:
        whole = self._recording.pair_sets.get(sequence)
        if whole is not None:
            return whole
        ticks = self._found_from.get(sequence)
        if ticks is None or any(tick not in kept for tick, kept in zip(ticks, self._kept, strict=True)):
            raise UserError(f"the bag has no organ contacts number {sequence}; its recording lost messages")
        for tick, kept in zip(ticks, self._kept, strict=True):
            for old in [one for one in kept if one < tick]:  # sets come in the order of their surfaces
                del kept[old]
        while self._surfaces and self._surfaces[0][2] <= sequence:
            organ, number, _ = self._surfaces.pop(0)
            self._finder.exchange(organ, self._organs[organ].surface_after(number), number)
        return self._finder.find([kept[tick] for tick, kept in zip(ticks, self._kept, strict=True)])
