"""Timing of the loop, from its notes about every tick."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from tissue_sim.array_types import Floats
from tissue_sim.model.runtime import mailboxes as mb
from tissue_sim.ros.shared.organs import Organs

LEAST_ELAPSED = 50_000_000  # ns, at least, over which simulated time is compared with the clock
MOST_BEHIND = 0.005  # s that simulated and wall time may be apart without a report


@dataclass(frozen=True)
class Timing:
    """Timing of the loop since the last check."""

    ticks: int
    seconds: float  # of wall time
    late: Floats  # (ticks,) s that each began after it was due
    busy: Floats  # (ticks,) s that each took
    behind: float  # s, largest lag of simulated time behind the clock
    late_ticks: int  # ticks that began more than a period late
    dropped_ticks: int  # ticks that were dropped
    overruns: int  # ticks that began more than a period late, in all
    dropped: int  # ticks dropped because the loop was too far behind, in all
    real_time_factor: float  # simulated time over that of the clock; 1 while the clock stands

    @property
    def rate(self) -> float:
        """Ticks per second of wall time."""
        return self.ticks / self.seconds

    @property
    def load(self) -> float:
        """Fraction of the wall time that the ticks took."""
        return float(self.busy.sum()) / self.seconds

    @property
    def late_fraction(self) -> float:
        """Fraction of the ticks that began more than a period late."""
        return self.late_ticks / max(self.ticks, 1)


class TimingReader:
    """Reader of a loop's notes; each reader has its own last check."""

    def __init__(self, organs: Organs) -> None:
        self._organs, self._words = organs, organs.loop.words
        self._last = self._look()

    def read(self) -> Timing:
        """Return the timing since the last call."""
        control, last = self._words.control, self._last
        paused = self._organs.loop.pause.active  # before and after: a pause may begin or end in between
        due, napping = int(control.due), int(control.napping)
        new = self._last = self._look()
        first = max(last.ticks, new.ticks - mb.TIMING_ROWS + 64)
        rows = self._words.timing[np.arange(first, new.ticks) % mb.TIMING_ROWS]
        late, busy = 1e-9 * rows["late"], 1e-9 * rows["duration"]
        behind = float(late.max(initial=0.0))
        # Posted times come in steps; the loop itself notes how far it was from one when the next one comes.
        if due and not new.posted and not napping and not paused:
            behind = max(behind, new.wall - 1e-9 * due - self._tick_time())
        # After a change of the clock, a jump back, or within a very short time there is nothing to compare.
        elapsed = new.clock - last.clock if new.posted == last.posted else 0
        return Timing(
            ticks=new.ticks - last.ticks,
            seconds=max(new.wall - last.wall, 1e-9),
            late=late,
            busy=busy,
            behind=behind,
            late_ticks=new.overruns - last.overruns,
            dropped_ticks=new.dropped - last.dropped,
            overruns=new.overruns,
            dropped=new.dropped,
            real_time_factor=(new.simulated - last.simulated) / elapsed if elapsed > LEAST_ELAPSED else 1.0,
        )

    def _look(self) -> _Counters:
        control = self._words.control
        pause = self._organs.loop.pause
        posted = int(control.sim_time and not pause.active)
        return _Counters(
            wall=time.monotonic(),
            posted=posted,
            clock=int(control.posted_time) if posted else round(1e9 * pause.now()),
            ticks=int(control.loop_ticks),
            simulated=int(control.simulated),
            overruns=int(control.overruns),
            dropped=int(control.dropped),
        )

    def _tick_time(self) -> float:
        """Return the tick time of the newest settings, s."""
        return self._organs.tick_time


@dataclass(frozen=True)
class _Counters:
    """The loop's counters at one check."""

    wall: float  # s
    posted: int  # 1 while ticks follow a posted time
    clock: int  # ns
    ticks: int
    simulated: int  # ns
    overruns: int
    dropped: int
