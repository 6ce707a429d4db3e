"""How the loop keeps time, from what it notes about every tick."""

from __future__ import annotations

import time
from typing import NamedTuple

import numpy as np

from tissue_sim.model import realtime as rt
from tissue_sim.model import state as st

MOST_BEHIND = 0.005  # s that simulated and wall time may be apart before it is told


class Timing(NamedTuple):
    """How the loop kept time since the last look."""

    ticks: int
    rate: float  # ticks a second of wall time
    load: float  # share of the wall time that they took
    p50: float  # s, duration of a tick
    p99: float
    late_p99: float  # s
    late_ticks: int  # ticks that began more than a period late
    behind: float  # s, farthest that simulated time was behind the clock
    overruns: int  # ticks that began more than a period late, in all
    dropped: int  # ticks given up because the loop was too far behind, in all
    new_dropped: int  # the same, since the last look
    real_time_factor: float  # simulated time over that of the clock; 1 while the clock stands


class TimingReader:
    """Looks at a loop's mailboxes now and then; each reader has its own last look."""

    def __init__(self, box: rt.Mailboxes) -> None:
        self._box = box
        self._look()

    def read(self) -> Timing:
        """Timing since the last call."""
        ticks, clock, simulated, wall, overruns = self._ticks, self._clock, self._simulated, self._wall, self._overruns
        posted, dropped = self._posted, self._dropped
        self._look()
        first = max(ticks, self._ticks - rt.TIMING_ROWS + 64)
        rows = self._box.timing[np.arange(first, self._ticks) % rt.TIMING_ROWS]
        late, busy = (rows * 1e-9).T if len(rows) else (np.zeros(1), np.zeros(1))
        # After a change of the clock or a jump back there is nothing to compare.
        elapsed = self._clock - clock if posted == self._posted else 0
        gone, seconds = self._simulated - simulated, max(self._wall - wall, 1e-9)
        return Timing(
            ticks=self._ticks - ticks,
            rate=(self._ticks - ticks) / seconds,
            load=float(busy.sum()) / seconds,
            p50=float(np.percentile(busy, 50)),
            p99=float(np.percentile(busy, 99)),
            late_p99=float(np.percentile(late, 99)),
            late_ticks=self._overruns - overruns,
            behind=max(float(late.max()), self._behind),
            overruns=self._overruns,
            dropped=self._dropped,
            new_dropped=self._dropped - dropped,
            real_time_factor=gone / elapsed if elapsed > 0 else 1.0,
        )

    def _look(self) -> None:
        control = self._box.control
        self._wall = time.monotonic()
        self._posted = int(control[rt.SIM_TIME])
        due, napping = int(control[rt.DUE]), int(control[rt.NAPPING])
        self._ticks, self._simulated = int(control[rt.LOOP_TICKS]), int(control[rt.SIMULATED])
        self._overruns, self._dropped = int(control[rt.OVERRUNS]), int(control[rt.DROPPED])
        self._clock = int(control[rt.POSTED_TIME]) if self._posted else time.monotonic_ns()
        # Posted times come in steps; the loop itself notes how far it was from one when the next one comes.
        self._behind = 0.0
        if due and not self._posted and not napping:
            self._behind = 1e-9 * max(0, self._clock - due - self._tick_time())

    def _tick_time(self) -> int:
        """ns, of the newest settings."""
        return int(1e9 * self._box.settings[int(self._box.settings_sequence[0]) % rt.IN_SLOTS, st.TICK_TIME])
