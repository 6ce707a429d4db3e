"""A passivity observer and controller for the forces that go out to a device (Hannaford and Ryu 2002), in time domain.

It sums the energy that the device has got so far, from the forces that went out and the poses that came. Where that is
more than the device has put in, it adds as much damping as takes the rest out in the next period.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from typing import Protocol

import numpy as np

from tissue_sim.array_types import Floats
from tissue_sim.model.settings import Settings

LONGEST = 64  # forces that are remembered: those that are on their way
LATE = 1.5  # periods without a pose, after which it is overdue


class Observer:
    """The energy of one device, and the damping that keeps it from getting more than it has put in."""

    def __init__(self) -> None:
        self._sent: deque[Floats] = deque(maxlen=LONGEST)  # (3,) N, the newest first
        self._energy = 0.0  # J that the device has put in
        self._place: Floats | None = None

    def forget(self) -> None:
        """Begin anew: poses have stopped."""
        self._sent.clear()
        self._energy, self._place = 0.0, None

    def damped(self, place: Floats, force: Floats, period: float, lag: float, most: float) -> Floats:
        """Return the force (3,) N that is to go out, in place of one, in answer to a pose at a place (3,) m.

        period s between poses; lag s from a pose until the force acts that answers it; most N s/m that is added. What
        goes out in the end is reported to `sent`.
        """
        way = np.zeros(3) if self._place is None else place - self._place
        self._energy -= float(self._acted(lag / period) @ way)
        self._place = place.copy()
        square = float(way @ way)
        if not force.any():  # nothing is touched: what was put in before is none of the next touch's
            self._energy = 0.0
        elif self._energy < 0.0 and square > 0.0:
            damping = min(-self._energy * period / square, most)
            return force - damping / period * way
        return force

    def sent(self, force: Floats) -> None:
        """Note the force (3,) N that went out."""
        self._sent.appendleft(force.copy())

    def _acted(self, periods: float) -> Floats:
        """Return the mean force (3,) N between the last two poses, if forces act so many periods after their poses."""
        whole = math.floor(periods)
        newer, older = self._force(whole), self._force(whole + 1)
        return newer + (periods - whole) * (older - newer)

    def _force(self, back: int) -> Floats:
        return self._sent[back] if back < len(self._sent) else np.zeros(3)


class Stream(Protocol):
    """What is measured of a tool's poses."""

    @property
    def period(self) -> float:
        """Seconds between two of them."""

    @property
    def delay(self) -> float:
        """Seconds until one has come."""


class DevicePort:
    """A tool's force on its way to the device: damped as its observer asks, and within `force_clamp` still.

    poses: of the tool; scale: m of the tool for one of the device; most: `passivity_damping`, N s/m, 0 for no observer;
    settings: tells the newest ones.
    """

    def __init__(self, poses: Stream, scale: float, most: float, settings: Callable[[], Settings]) -> None:
        self.most = most
        self._poses, self._scale, self._settings = poses, scale, settings
        self._observer = Observer()
        self.damped = 0  # forces that were

    @property
    def patience(self) -> float:
        """Seconds for which a damped force stands, until the next pose is overdue or the last one stale."""
        return min(LATE * self._poses.period, self._settings().stale_time) if self.most > 0.0 else 0.0

    def forget(self) -> None:
        """Begin anew: poses have stopped."""
        self._observer.forget()

    def felt(self, place: Floats, wrench: Floats) -> Floats:
        """Return the wrench (6,) N, N m that answers a pose at a place (3,) m, all in the organ's axes."""
        most = self.most
        if most == 0.0 or not np.isfinite(wrench).all():
            self._observer.forget()
            return wrench
        settings, poses = self._settings(), self._poses
        lag = 2.0 * poses.delay + settings.tick_time
        force = self._observer.damped(place / self._scale, wrench[:3], poses.period, lag, most)
        self.damped += int((force != wrench[:3]).any())
        size = math.sqrt(float(force @ force))
        if size > settings.force_clamp:
            force = force * (settings.force_clamp / size)
        self._observer.sent(force)
        return np.concatenate([force, wrench[3:]])
