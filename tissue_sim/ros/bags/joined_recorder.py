"""What joins the organs of a scene, as a part of a bag."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tissue_sim.array_types import Array, Longs
from tissue_sim.model.stepping.breathing import Breath
from tissue_sim.model.stepping.contact_pairs import OrganContactSet, used_words
from tissue_sim.ros.bags import bag
from tissue_sim.ros.bags.bag_messages import BagMessages
from tissue_sim.ros.shared.loop import Loop
from tissue_sim.ros.shared.physics import unread_rows


class JoinedRecorder:
    """Writes where organs touch, and what they hang on; nothing for an organ alone.

    below: the topics' beginning, absolute.
    """

    def __init__(self, messages: BagMessages, below: str, loop: Loop) -> None:
        topics = ["journal"] if loop.joined.alone else bag.SCENE_TOPICS
        self.names = {name: f"{below}/{name}" for name in topics}
        self.lock = messages.lock
        self._messages, self._joined, self._box = messages, loop.joined, loop.joined_box
        self._read = 0  # rows of the loop's journal
        self._notes: list[tuple[int, Sequence[int]]] = []
        self._surfaces: dict[int, tuple[int, int, int]] = {}  # by organ, the newest bag.PairSurfaceRow
        self._surface_notes: list[tuple[int, int, int]] = []
        self._newest: tuple[int, Longs] | None = None  # number and words of a set
        self._newest_fraction = (0, 0.0)  # number, and fraction of the breath's displacement
        self._fractions = [self._newest_fraction]
        self._state_tick = -1

    def begin(self) -> None:
        """Begin a bag; call it with `lock` held."""
        self._read, self._notes, self._state_tick = int(self._box.journal_written[0]), [], -1
        self._surface_notes = list(self._surfaces.values())
        self._fractions = [self._newest_fraction]
        if self._newest is not None:
            self._whole_set(*self._newest)

    def state(self, tick: int) -> None:
        """Record what joined the organs at the tick of the states that the loop has posted."""
        joined, kept = self._joined, self._box.snapshot
        if joined.alone:
            return
        count = int(kept.pairs.found[0])
        fields: dict[str, Array] = {f"links.{name}": array for name, array in joined.links._asdict().items()}
        fields |= {
            "breath": Breath.rows(kept.breath.copy()),
            "moves": joined.carried.moves,
            "friction": joined.pairs.friction,
            "pairs": used_words(kept.pairs).copy(),
            "pressed": kept.pressed[:count].copy(),
            "held": kept.held[:count].copy(),
            "versions": kept.version[: len(joined.simulations)].copy(),
        }
        self._messages.packed(self.names["joined"], fields)
        self._state_tick = tick

    def pairs(self, sequence: int, ticks: Sequence[int], found: OrganContactSet) -> None:
        """Record what pairs were found from, or all of them while a surface may not be in the bag.

        Call it with `lock` held since they were posted.

        ticks (k,): ticks of the surfaces that they were found from.
        """
        self._newest = sequence, used_words(found).copy()
        if not self._messages.active:
            return
        self._notes.append((sequence, ticks))
        # Where an organ touches itself, the result depends on where it touched the last time.
        touches_itself = bool(np.any(found.organ[: found.found[0], 0] == found.organ[: found.found[0], 1]))
        if self._state_tick < 0 or min(ticks) <= self._state_tick or touches_itself:
            self._whole_set(*self._newest)

    def surface(self, organ: int, number: int, is_cut: bool) -> None:
        """Record that pairs are found on the surface of an organ after a cut from now on.

        Call it with `lock` held.

        number: number of the cut; is_cut: whether the organ has cuts on it, and not none after their reset.
        """
        row = organ, number, int(self._box.pairs.sequence[0]) + 1
        self._surfaces.pop(organ, None)
        if is_cut:  # a bag that begins later begins with this surface
            self._surfaces[organ] = row
        if self._messages.active:
            self._surface_notes.append(row)

    def respiration(self, sequence: int, fraction: float) -> None:
        """Record where the breath is to be; call it with `lock` held since it was posted.

        fraction: fraction of the breath's displacement.
        """
        self._newest_fraction = sequence, fraction
        if self._messages.active:
            self._fractions.append(self._newest_fraction)

    def rows(self) -> dict[str, Array]:
        """Return the journal's rows since the last call; to be called with `lock` held."""
        if self._joined.alone:
            return {}
        written = int(self._box.journal_written[0])
        chosen = unread_rows(self._read, written)
        self._read = written
        noted, self._notes = self._notes, []
        fractions, self._fractions = self._fractions, []
        surfaces, self._surface_notes = self._surface_notes, []
        n_organs = len(self._joined.simulations)
        return {
            "joined": self._box.journal[chosen],
            "respiration": np.array(fractions, dtype=bag.RespirationRow.dtype),
            "pairs": np.array([(sequence,) for sequence, _ in noted], dtype=bag.PairRow.dtype),
            "pair_surfaces": np.array(surfaces, dtype=bag.PairSurfaceRow.dtype),
            "pair_ticks": np.array([ticks for _, ticks in noted], dtype=np.int64).reshape(-1, n_organs),
        }

    def _whole_set(self, sequence: int, words: Longs) -> None:
        self._messages.packed(self.names["organ_contact_set"], {"sequence": np.array(sequence), "words": words})
