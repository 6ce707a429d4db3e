"""Pausing of a loop: it takes no ticks but those that it is given one by one."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Protocol

from tissue_sim.model.runtime.mailboxes import LoopWords

LONGEST = 1.0  # s that the loop may need until it stands, goes on, or has done a tick
LOOK = 1e-4  # s between two checks whether it has
SECOND = 1_000_000_000  # ns


class Pausable(Protocol):
    """What the control needs of its loop."""

    @property
    def words(self) -> LoopWords:
        """What it shares with its compiled part."""

    @property
    def alive(self) -> bool:
        """Whether its thread runs."""

    @property
    def ticks(self) -> int:
        """Ticks executed so far."""

    @property
    def tick_time(self) -> float:
        """Seconds of a tick."""

    def post_time(self, nanoseconds: int) -> None:
        """Give the time that is followed, ns."""

    def follow_posted_time(self, on: bool) -> None:
        """Follow times that are posted, or the monotonic clock."""


class PauseControl:
    """Control that pauses a running loop that follows the monotonic clock; any thread may call it.

    A paused loop follows a time of its own, as others follow /clock: that stands, and advances by a tick at a time, so
    that exactly those ticks are due.
    """

    def __init__(self, loop: Pausable) -> None:
        self._loop = loop
        self._time = 0  # ns, followed by a paused loop
        self._lost = 0.0  # s of the monotonic clock for which loops were paused
        self._frozen: float | None = None  # s, the time of `now` while paused
        self._lock = threading.Lock()

    @property
    def active(self) -> bool:
        """Whether the loop is paused."""
        return self._frozen is not None

    def now(self) -> float:
        """Return the monotonic time, without that for which the loop was paused, and with the ticks in it, s."""
        frozen = self._frozen
        return time.monotonic() - self._lost if frozen is None else frozen

    def begin(self) -> None:
        """Pause the loop; return when its last tick is done.

        Raises TimeoutError when the loop doesn't answer; it is paused as soon as it does.
        """
        with self._lock:
            if self.active:
                return
            control, phase = self._loop.words.control, self._loop.words.phase
            self._frozen = self.now()
            self._time += SECOND  # another one than the loop has seen
            self._loop.post_time(self._time)
            self._loop.follow_posted_time(True)
            self._wait(lambda: control.standing and phase.seen == self._time)

    def end(self) -> None:
        """Let the loop follow the monotonic clock again; return when it has done a tick.

        Raises TimeoutError when the loop doesn't answer.
        """
        with self._lock:
            if self._frozen is None:
                return
            before = self._loop.ticks
            self._loop.follow_posted_time(False)
            try:
                self._wait(lambda: self._loop.ticks > before)
            finally:
                self._lost = time.monotonic() - self._frozen
                self._frozen = None

    @contextmanager
    def kept(self) -> Iterator[bool]:
        """Keep a paused loop from taking ticks meanwhile, and another from being paused; yield whether it is paused."""
        with self._lock:
            yield self.active

    def step(self) -> bool:
        """Have one tick done; return whether it was: False where the loop is no longer paused.

        Raises TimeoutError when the loop doesn't answer.
        """
        with self._lock:
            if self._frozen is None:
                return False
            before, period = self._loop.ticks, int(1e9 * self._loop.tick_time + 0.5)  # as the loop rounds it
            self._time += period
            self._loop.post_time(self._time)
            self._wait(lambda: self._loop.ticks > before)
            self._frozen += 1e-9 * period
            return True

    def _wait(self, done: Callable[[], bool]) -> None:
        end = time.monotonic() + LONGEST
        while not done():
            if not self._loop.alive or time.monotonic() > end:
                raise TimeoutError("the physics loop doesn't answer")
            time.sleep(LOOK)
