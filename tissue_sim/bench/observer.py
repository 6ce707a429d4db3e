"""A passivity observer and controller for forces that go out to a device (Hannaford and Ryu 2002), in time domain.

It sums the energy that the device has got so far, from the forces that went out and the poses that came. Where that is
more than the device has put in, it adds as much damping as takes the rest out in the next period.
"""

from __future__ import annotations

import math
from collections import deque


class Observer:
    """For poses that come every `period` s, and forces that act `lag` s after their poses; most: N s/m that it adds."""

    def __init__(self, period: float, lag: float, most: float) -> None:
        self._period, self._most = period, most
        whole = math.floor(lag / period)
        self._late = lag / period - whole  # part of a period in which the force before still acts
        self._sent = deque([0.0] * (whole + 2), maxlen=whole + 2)  # N, the newest last
        self._energy = 0.0  # J that the device has put in
        self._place: float | None = None

    def send(self, place: float, force: float) -> float:
        """Return the force, N, that goes out in answer to a pose at a place, m."""
        way = 0.0 if self._place is None else place - self._place
        self._energy -= (self._late * self._sent[0] + (1.0 - self._late) * self._sent[1]) * way
        if force == 0.0:  # nothing is touched: what was put in before is none of the next touch's
            self._energy = 0.0
        elif self._energy < 0.0 and way != 0.0:
            speed = way / self._period
            damping = min(-self._energy / (self._period * speed * speed), self._most)
            force -= damping * speed
        self._place = place
        self._sent.append(force)
        return force
