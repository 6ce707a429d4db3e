"""A time-domain passivity observer and controller [1]_ for the forces that are sent to a device.

It sums the energy that the device has received so far, from the forces sent and the poses received. Where that is more
than the device has put in, it adds as much damping as removes the rest in the next period.

References
----------
.. [1] B. Hannaford and J.-H. Ryu, "Time-domain passivity control of haptic interfaces", IEEE Transactions on Robotics
   and Automation 18, 2002.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from typing import Protocol

import numpy as np

from tissue_sim.array_types import Floats
from tissue_sim.model.data.settings import Settings

LONGEST = 64  # remembered forces: those on their way
LATE = 1.5  # periods without a pose, after which it is overdue


class Observer:
    """The energy of one device, and the damping that keeps it from receiving more than it has put in."""

    def __init__(self) -> None:
        self._sent: deque[Floats] = deque(maxlen=LONGEST)  # (3,) N, the newest first
        self._energy = 0.0  # J that the device has put in
        self._place: Floats | None = None

    def forget(self) -> None:
        """Begin again: poses have stopped."""
        self._sent.clear()
        self._energy, self._place = 0.0, None

    def damped(self, place: Floats, force: Floats, period: float, lag: float, most: float) -> Floats:
        """Return the force to send instead of a given one in answer to a pose.

        Report the force that is finally sent to `sent`.

        place (3,) m: position of the pose; force (3,) N: the given force; period: time between poses, s; lag: time from
        a pose until the force that answers it acts, s; most: largest damping that is added, N s/m. Returns (3,)
        N.
        """
        moved = np.zeros(3) if self._place is None else place - self._place
        self._energy -= float(self._acted(lag / period) @ moved)
        self._place = place.copy()
        square = float(moved @ moved)
        if not force.any():  # nothing is touched: earlier energy doesn't count for the next touch
            self._energy = 0.0
        elif self._energy < 0.0 and square > 0.0:
            damping = min(-self._energy * period / square, most)
            return force - damping / period * moved
        return force

    def sent(self, force: Floats) -> None:
        """Note the force (3,) N that was sent."""
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
        """Time between two of them, s."""

    @property
    def delay(self) -> float:
        """Time until one has come, s."""


class DevicePort:
    """A tool's force on its way to the device: damped as its observer requires, and still within `force_clamp`.

    poses: stream of the tool's poses; scale: motion of the tool for the same motion of the device; most: the parameter
    `passivity_damping` (0: no observer), N s/m; settings: returns the newest settings.
    """

    def __init__(self, poses: Stream, scale: float, most: float, settings: Callable[[], Settings]) -> None:
        self.most = most
        self._poses, self._scale, self._settings = poses, scale, settings
        self._observer = Observer()
        self.damped = 0  # number of damped forces

    @property
    def patience(self) -> float:
        """Time, s, that a damped force stands: until the next pose is overdue or the last one stale."""
        return min(LATE * self._poses.period, self._settings().stale_time) if self.most > 0.0 else 0.0

    def forget(self) -> None:
        """Begin again: poses have stopped."""
        self._observer.forget()

    def passive_wrench(self, place: Floats, wrench: Floats) -> Floats:
        """Return the wrench that answers a pose, all in the organ's axes.

        place (3,) m: position of the pose; wrench (6,) N and N m: wrench of the simulation. Returns (6,) N and N
        m.
        """
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
