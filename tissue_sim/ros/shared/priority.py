"""Real-time priorities of threads (SCHED_FIFO) from 1 to HIGHEST, where the system allows them; 0 is none."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager

HIGHEST = 99


def prefer(priority: int, thread: int = 0) -> None:
    """Let a thread, 0 for the calling one, go before those of lower priority and those without.

    Threads that it starts later are none the better for it. Raises PermissionError where the system doesn't allow it.
    """
    if priority:
        os.sched_setscheduler(thread, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(priority))


def is_allowed(priority: int) -> bool:
    """Whether a thread of this process may have a priority; tried in one that ends: not every one may give it back."""
    found = []

    def ask() -> None:
        try:
            prefer(priority)
        except OSError:
            return
        found.append(True)

    trial = threading.Thread(target=ask)
    trial.start()
    trial.join()
    return bool(found)


@contextmanager
def preferred(priority: int) -> Iterator[None]:
    """The calling thread with a priority for a while. Raises PermissionError, see `prefer`."""
    prefer(priority)
    try:
        yield
    finally:
        if priority:
            os.sched_setscheduler(0, os.SCHED_OTHER | os.SCHED_RESET_ON_FORK, os.sched_param(0))


def below(priority: int) -> int:
    """The priority of what goes right after it: of the thread that answers poses, after the loop."""
    return max(priority - 1, min(priority, 1))
