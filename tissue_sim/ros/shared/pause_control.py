"""Holding of a loop: it takes no ticks but those that it is given one by one."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, Protocol

LONGEST = 1.0  # s that the loop may need until it stands, goes on, or has done a tick
LOOK = 1e-4  # s between two checks whether it has
SECOND = 1_000_000_000  # ns


class Holdable(Protocol):
    """What a hold needs of the loop, which has it for a part."""

    words: Any

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
    """Control that holds a running loop that follows the monotonic clock; any thread may call it.

    A held loop follows a time of its own, as others follow /clock: that stands, and advances by a tick at a time, so
    that exactly those ticks are due.
    """

    def __init__(self, loop: Holdable) -> None:
        self._loop = loop
        self._time = 0  # ns, followed by a held loop
        self._lost = 0.0  # s of the monotonic clock for which loops were held
        self._frozen: float | None = None  # s, the time of `now` while held
        self._lock = threading.Lock()

    @property
    def active(self) -> bool:
        """Whether the loop is held."""
        return self._frozen is not None

    def now(self) -> float:
        """Return the monotonic time, without that for which the loop was held, and with the ticks in it, s."""
        frozen = self._frozen
        return time.monotonic() - self._lost if frozen is None else frozen

    def begin(self) -> None:
        """Hold the loop; return when its last tick is done.

        Raises TimeoutError when the loop doesn't answer; it is held as soon as it does.
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
        """Keep a held loop from taking ticks meanwhile, and another from being held; yield whether it is held."""
        with self._lock:
            yield self.active

    def step(self) -> bool:
        """Have one tick done; return whether it was: False where the loop is no longer held.

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
