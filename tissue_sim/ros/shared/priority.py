"""Real-time priorities of threads (SCHED_FIFO) from 1 to HIGHEST, where the system allows them; 0 is none."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

HIGHEST = 99


def prefer(priority: int, thread: int = 0) -> None:
    """Give a thread, 0 for the calling one, a real-time priority.

    Threads that it starts later don't inherit it.

    priority: the priority (0 changes nothing); thread: number of the thread. Raises PermissionError where the system
    doesn't allow it.
    """
    if priority:
        os.sched_setscheduler(thread, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(priority))


def is_allowed(priority: int) -> bool:
    """Return whether a thread of this process may have a priority."""
    try:
        with_priority(lambda: None, priority)
    except OSError:
        return False
    return True


def with_priority[Result](work: Callable[[], Result], priority: int) -> Result:
    """Return the result of work done in a thread of its own with a priority: not every thread may give one back.

    It raises what work raises, too.

    Raises PermissionError where the system doesn't allow it, see `prefer`.
    """

    def preferred() -> Result:
        prefer(priority)
        return work()

    with ThreadPoolExecutor(1) as thread:
        return thread.submit(preferred).result()


def below(priority: int) -> int:
    """Return the priority right below: of the thread that answers poses, after the loop."""
    return max(priority - 1, min(priority, 1))
