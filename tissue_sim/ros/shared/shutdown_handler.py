"""End of the node on SIGINT and SIGTERM in time, whatever it is doing."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from types import FrameType

from tissue_sim.unexpected_errors import write_error

SIGNALS = (signal.SIGINT, signal.SIGTERM)
START_GRACE = 0.4  # s in which a node that is still starting may end by itself
GRACE = 5.0  # s in which a node that runs may close


class Interrupted(BaseException):
    """A signal during the node's start; not an Exception, so that no handler on the way catches it."""


class ShutdownHandler:
    """Handler of the signals, also while the main thread is inside the compiler, which no Python handler interrupts.

    While starting, a signal raises Interrupted in the main thread; where that comes too late, and inside the compiler,
    which may crash on half-made state, the process ends without it: no bag is open yet, and no force was published.
    Once running, the node closes; one that can't in 5 s ends as it is. Further signals change nothing: a launcher often
    sends its own after the terminal's. Make it in the main thread.
    """

    def __init__(self) -> None:
        # Set by the watching thread alone: a handler would wait forever where it interrupts the thread that holds the
        # event's lock, as the handler of another signal does.
        self.asked = threading.Event()
        self._signalled = False
        self._starting, self._raised = True, False
        read, write = os.pipe()
        os.set_blocking(write, False)
        signal.set_wakeup_fd(write, warn_on_full_buffer=False)
        for number in SIGNALS:
            signal.signal(number, self._on_signal)
        self._unraisable, sys.unraisablehook = sys.unraisablehook, self._on_unraisable
        threading.Thread(target=self._watch, args=(read,), name="ending", daemon=True).start()

    @property
    def interrupted(self) -> bool:
        """Whether Interrupted was raised."""
        return self._raised

    def started(self) -> None:
        """Note that the node runs, and closes itself when asked to; raise Interrupted if it was asked before."""
        self.closes()
        if self._signalled or self.asked.is_set():
            raise Interrupted

    def closes(self) -> None:
        """Note that the main thread is able to close what there is."""
        self._starting = False

    def _on_signal(self, _: int, frame: FrameType | None) -> None:
        """Handle a signal in the main thread, as soon as it is back in Python."""
        self._signalled = True
        # A second one must not disturb what the first one has begun.
        if self._starting and not self._raised and not _is_compiling(frame):
            self._raised = True
            raise Interrupted

    def _on_unraisable(self, unraisable: sys.UnraisableHookArgs) -> None:
        """Ignore the error: Interrupted is lost in a callback from C, and its half-made state fails once more.

        The process ends nevertheless.
        """
        if not self._raised:
            self._unraisable(unraisable)

    def _watch(self, pipe: int) -> None:
        """Wait in a separate thread for the pipe that the system's handler writes to."""
        os.read(pipe, 1)
        self.asked.set()
        if self._starting:
            time.sleep(START_GRACE)
        if self._starting:
            _leave(0, "ended while starting")
        time.sleep(GRACE)
        _leave(1, f"could not shut down within {GRACE:g} s")


def _is_compiling(frame: FrameType | None) -> bool:
    """Return whether the compiler's code, or code that it calls, is running."""
    while frame is not None:
        if frame.f_globals.get("__name__", "").partition(".")[0] in ("numba", "llvmlite"):
            return True
        frame = frame.f_back
    return False


def _leave(code: int, line: str) -> None:
    write_error(f"tissue_node: {line}\n")
    os._exit(code)
