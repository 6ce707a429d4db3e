"""Degradation in a stated order, while the machine is too slow for the node: markers, modal region, rate."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

NONE, MARKERS, REGION, RATE = range(4)  # from RATE on each further level halves the rate again
LEVELS = RATE + 3
NAMES = ("none", "markers", "region", "rate")

LOOK_EVERY = 0.25  # s
MARKER_RATE = 10.0  # Hz, from level MARKERS on
STRAINED_LOAD, WELL_LOAD = 0.8, 0.35  # of the wall time, in ticks; well: even twice the rate would not strain
STRAINED_LATE, WELL_LATE = 0.2, 0.05  # fraction of ticks late by more than a period
PATIENCE = 1.0  # s of strain before the next step
SETBACK = 1.0  # s of being well that a check takes away that is neither
HOLD, LONGEST_HOLD = 10.0, 160.0  # s of being well before a step back; doubled each time that this was too soon


class Look(NamedTuple):
    """Load of the loop since the last check."""

    load: float  # fraction of the wall time spent in ticks
    late: float  # fraction of its ticks late by more than a period
    dropped: int  # ticks that it dropped

    @property
    def strained(self) -> bool:
        """Whether the machine is too slow."""
        return self.load > STRAINED_LOAD or self.late > STRAINED_LATE or self.dropped > 0

    @property
    def words(self) -> str:
        """Its measurements, as text."""
        lost = f", {self.dropped} were dropped" if self.dropped else ""
        return f"ticks took {100 * self.load:.0f} % of the time, {100 * self.late:.0f} % of them were late{lost}"

    @property
    def well(self) -> bool:
        """Whether there is room to take a step back."""
        return self.load < WELL_LOAD and self.late < WELL_LATE and self.dropped == 0


def name(level: int) -> str:
    """Return the name of a level, as in diagnostics."""
    return NAMES[min(level, RATE)]


def halvings(level: int) -> int:
    """Return how often the rate is halved at a level."""
    return max(0, level - RATE + 1)


class DegradationLadder:
    """Decision on the level from one check to the next, without a clock or a node of its own.

    A step is taken after a second of uninterrupted strain, and reverted after ten seconds without strain in which the
    machine was fast enough. A check that is neither strained nor well takes SETBACK off these ten seconds, since even
    an idle machine is late at times. If a step has to be taken again soon after it was reverted, reverting it takes
    twice as long.
    """

    def __init__(self) -> None:
        self.level = NONE
        self.stuck = False  # True while strained with nothing left to give up
        self._hold = HOLD
        self._back_at = -LONGEST_HOLD  # s, when the last step back was taken
        self._strained_since = -1.0  # s; negative: it isn't
        self._well_for, self._looked_at = 0.0, math.inf  # s

    def look(self, now: float, look: Look, helps: Callable[[int], bool]) -> bool:
        """Judge a check.

        now: its time, s; look: what it found; helps: returns whether a level gives anything up. Returns whether the
        level changed.
        """
        self._strained_since = _since(self._strained_since, now, look.strained)
        self._well_for = self._well_seconds(look, max(0.0, now - self._looked_at))
        self._looked_at = now
        self.stuck = self.stuck and look.strained
        if self._strained_since >= 0.0 and now - self._strained_since >= PATIENCE:
            further = next((level for level in range(self.level + 1, LEVELS) if helps(level)), None)
            self.stuck = further is None
            if further is None:
                return False
            self._hold = min(2.0 * self._hold, LONGEST_HOLD) if now - self._back_at < self._hold else HOLD
            return self._go(further)
        if self.level > NONE and self._well_for >= self._hold:
            self._back_at = now
            return self._go(next(level for level in range(self.level - 1, -1, -1) if level == NONE or helps(level)))
        return False

    def _go(self, level: int) -> bool:
        self.level = level
        self._strained_since, self._well_for = -1.0, 0.0
        return True

    def _well_seconds(self, look: Look, elapsed: float) -> float:
        """Return the seconds of being well, after a check so many s later."""
        if look.strained:
            return 0.0
        return self._well_for + elapsed if look.well else max(0.0, self._well_for - SETBACK)


def _since(since: float, now: float, true: bool) -> float:
    if not true:
        return -1.0
    return now if since < 0.0 else since
