"""Ctrl-C that is remembered: compiled libraries call Python back, and drop the exception that it raises there."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType


class _Seen:
    """State of this process: whether an interrupt came, and what it leaves of the work."""

    any = False
    left = ""


def remember() -> None:
    """Raise KeyboardInterrupt on SIGINT as Python does, and remember it; a signal that is ignored stays so."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, interrupt)


def interrupt(number: int, frame: FrameType | None) -> None:
    """Remember the signal and raise KeyboardInterrupt.

    Parameters
    ----------
    number : int
        The signal.
    frame : FrameType | None
        Where it came.

    Raises
    ------
    KeyboardInterrupt
        Always.
    """
    _Seen.any = True
    signal.default_int_handler(number, frame)


def caused(error: BaseException) -> bool:
    """Return whether an error comes from an interrupt: itself, or one that follows, from what was left half done.

    Parameters
    ----------
    error : BaseException
        The error.

    Returns
    -------
    bool
        True for KeyboardInterrupt, and for every error after the signal.
    """
    return _Seen.any or isinstance(error, KeyboardInterrupt)


@contextmanager
def leaving(left: str) -> Iterator[None]:
    """Say what an interrupt of this block leaves, as the end of the line that reports it; an inner block goes first.

    Parameters
    ----------
    left : str
        Such as `nothing was written`, or how to continue.
    """
    try:
        yield
    except BaseException as error:
        if caused(error):
            _Seen.left = _Seen.left or left
        raise


def reported() -> str:
    """Return what the interrupt left, and count it as reported: errors after it are errors again.

    Returns
    -------
    str
        What `leaving` was given; empty where nothing was.
    """
    left, _Seen.left, _Seen.any = _Seen.left, "", False
    return left
