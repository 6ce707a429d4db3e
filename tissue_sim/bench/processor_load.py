"""Processor use of running processes, as a fraction of a core."""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Callable, Mapping

from tissue_sim.errors import UserError

_OF_PROCESS, _OF_THREAD = 2, 6


def processor_seconds(process: int, *, busiest: bool = True) -> float:
    """Return the processor time of a running process, including its threads that have ended, s.

    busiest: whether its busiest thread is included. Raises UserError where it has ended.
    """
    try:
        spent = _clock(process, _OF_PROCESS)
        threads = [] if busiest else os.listdir(f"/proc/{process}/task")
    except OSError as error:
        raise UserError(f"processor time of process {process} can't be read: {error.strerror}") from None
    most = 0.0
    for thread in threads:
        with contextlib.suppress(OSError):  # one that has ended meanwhile
            most = max(most, _clock(int(thread), _OF_THREAD))
    return spent - most


def _clock(number: int, kind: int) -> float:
    """Return the processor time of a process or thread, s, by how Linux numbers clocks (clock_getcpuclockid(3))."""
    return time.clock_gettime(~number << 3 | kind)


def processor_load_during(spent: Mapping[str, Callable[[], float]], wait: Callable[[], object]) -> dict[str, float]:
    """Return the percentage of a core that each process takes while `wait` runs.

    spent: functions that return the processor time so far, s, by name; wait: runs meanwhile. Returns them by name.
    """
    began, before = time.monotonic(), {name: read() for name, read in spent.items()}
    wait()
    after = {name: read() for name, read in spent.items()}
    return {name: 100.0 * (after[name] - before[name]) / (time.monotonic() - began) for name in spent}
