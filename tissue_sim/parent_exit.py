"""First steps of every process that works for another one."""

from __future__ import annotations

import ctypes
import multiprocessing
import os
import signal

PR_SET_PDEATHSIG = 1  # of prctl(2)

_libc = ctypes.CDLL(None, use_errno=True)


def exit_with_parent() -> None:
    """End this child process when its parent is gone, however that ended; otherwise it would run on unused.

    The signal is SIGTERM, not SIGINT, which would get lost while an interpreter starts again, as it does with the
    wheels. Only Linux has this; elsewhere nothing happens.
    """
    if hasattr(_libc, "prctl"):
        _libc.prctl(PR_SET_PDEATHSIG, signal.SIGTERM, 0, 0, 0)
    parent = multiprocessing.parent_process()
    if parent is not None and not parent.is_alive():  # it ended before the signal was requested
        os._exit(1)
