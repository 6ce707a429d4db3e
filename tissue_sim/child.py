"""What every process that works for another one does first."""

from __future__ import annotations

import ctypes
import multiprocessing
import os
import signal

PR_SET_PDEATHSIG = 1  # of prctl(2)

_libc = ctypes.CDLL(None, use_errno=True)


def end_with_parent() -> None:
    """In a child process: end when the parent is gone, however that ended; it would keep a core busy for nobody.

    By SIGTERM, not SIGINT: an interpreter that is about to start anew, as over the wheels, would lose that. Linux alone
    has this; elsewhere nothing happens.
    """
    if hasattr(_libc, "prctl"):
        _libc.prctl(PR_SET_PDEATHSIG, signal.SIGTERM, 0, 0, 0)
    parent = multiprocessing.parent_process()
    if parent is not None and not parent.is_alive():  # it was gone before it could be asked for
        os._exit(1)
