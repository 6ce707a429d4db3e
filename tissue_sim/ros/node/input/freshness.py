"""Freshness of inputs, by the one clock that ticks follow: /clock, or the monotonic one."""

from __future__ import annotations

import math
import time
from collections import deque

from tissue_sim.ros.node.shared.sim_clock import SimClock
from tissue_sim.ros.shared.organs import Organs

FIRST_PERIOD = 1e-3  # s between two messages, until they come
LONGEST_PERIOD = 0.1  # s between two messages of a stream
LONGEST_DELAY = 0.1  # s; a larger age means that clocks differ
NEW = 0.02  # weight of the newest message in averages
LONGEST_JUMP = 1.0  # s, that stamps of one stream may advance by more than the clock
LONGEST_GAP, GAPS = 1.0, 8  # s between messages of one stream, at most; number of gaps by which a stream counts as slow


class Freshness:
    """Arrival of the newest pose, or force, of a tool, by simulated time, and what follows from that.

    While /clock stands still no pose counts, so that no tool acts on the organ at once when the clock continues. After
    a jump back, or with another clock, the stream begins again. While the loop is paused, fresh poses stay fresh, so
    that contacts are found for the ticks that are stepped.
    """

    def __init__(self, clock: SimClock, organs: Organs) -> None:
        self.clock, self._organs = clock, organs
        self._came, self._stamp = -math.inf, 0  # s, ns
        self._arrived = -math.inf  # s of the monotonic clock, which goes on while the loop is held
        self._period, self._delay = FIRST_PERIOD, 0.0  # s, on average
        self._gaps: deque[float] = deque(maxlen=GAPS)  # s
        clock.jumped.append(self._forget)

    def came(self, stamp: int) -> None:
        """Note that a message was applied. stamp: its time, or UNSTAMPED, ns.

        One with the stamp of the last one is no newer, and keeps nothing fresh.
        """
        if self._repeats(stamp):
            return
        now = self.clock.now()
        if 0.0 < (gap := now - self._came) < LONGEST_PERIOD:  # several at one time of /clock count once for the ticks
            self._period += NEW * (gap - self._period)
        if 0.0 < gap < LONGEST_GAP:
            self._gaps.append(gap)
        elif gap > 0.0:
            self._gaps.clear()
        age = self.clock.age_of(stamp) if stamp > 0 else 0.0
        self._delay += NEW * ((age if 0.0 <= age <= LONGEST_DELAY else 0.0) - self._delay)
        self._came, self._stamp, self._arrived = now, stamp, time.monotonic()

    @property
    def age(self) -> float:
        """Time since the newest message, s; infinite when there was none."""
        return self.clock.now() - self._came

    @property
    def is_fresh(self) -> bool:
        """Whether less than `stale_time` has passed since the last message."""
        return not self._organs.loop.clock_stands and self.age <= self._organs.stale_time

    @property
    def counts(self) -> bool:
        """Whether a stale input has not yet faded, which takes a `ramp_time` more."""
        return not self._organs.loop.clock_stands and self.age < self._organs.stale_time + self._organs.ramp_time

    def stands_at(self, stamp: int) -> bool:
        """Return whether a stream repeats a message that is stale, as a driver does whose device has gone.

        stamp: stamp of the newest message, ns.
        """
        return self._repeats(stamp) and not self._organs.loop.standing and self.age > self._organs.stale_time

    @property
    def latest_stamp(self) -> float:
        """Latest stamp, ns, of the next message; infinite for a stream that begins again."""
        last = self.last_stamp
        if last <= 0:
            return math.inf
        return last + 1e9 * (max(self.age, time.monotonic() - self._arrived) + LONGEST_JUMP)

    @property
    def last_stamp(self) -> int:
        """Earliest stamp, ns, of the next message; 0 for a stream that begins again, with any stamp."""
        return self._stamp if self.counts and not self._organs.loop.standing else 0

    @property
    def period(self) -> float:
        """Mean time between two messages, s."""
        return self._period

    @property
    def too_slow(self) -> float:
        """Time between messages of a steady stream where each is stale before the next, s; 0 for any other."""
        gaps = sorted(self._gaps)
        gap = gaps[len(gaps) // 2] if len(gaps) == GAPS and self.age < LONGEST_GAP else 0.0
        return gap if gap > self._organs.stale_time else 0.0

    @property
    def delay(self) -> float:
        """Mean time from a message's stamp until it came, s.

        It is 0 for messages without a stamp, or from a machine whose clock is ahead, or far behind.
        """
        return self._delay

    def _repeats(self, stamp: int) -> bool:
        """Return whether a stamp, ns, is that of the newest message."""
        return 0 < stamp == self._stamp

    def _forget(self) -> None:
        self._came, self._stamp = -math.inf, 0
        self._gaps.clear()
