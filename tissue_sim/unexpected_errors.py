"""Unexpected errors: a user gets one line that names the place, and the traceback only on request."""

from __future__ import annotations

import os
import sys
import threading
import traceback
from pathlib import Path
from types import TracebackType

from tissue_sim.errors import UserError, printable, shown

TRACEBACK = "TISSUE_SIM_TRACEBACK"  # the traceback is shown, too, when this is set and not empty
LONGEST = 500  # characters of what an error says
INTERRUPTED = 130  # exit code of a program that Ctrl-C ended

_PACKAGE = Path(__file__).resolve().parent


def place_of(error: BaseException) -> str:
    """Return file and line of the innermost frame inside the package, else of the innermost one.

    Parameters
    ----------
    error : BaseException
        The error.

    Returns
    -------
    str
        The place; empty where there is none.
    """
    inside = outside = ""
    for frame, line in traceback.walk_tb(error.__traceback__):
        path = Path(frame.f_code.co_filename)
        if path.is_relative_to(_PACKAGE):
            inside = f"{path.relative_to(_PACKAGE.parent)}:{line}"
        else:
            outside = f"{path.name}:{line}"
    return inside or outside


def described(error: BaseException) -> str:
    """Return an error in one line: its type, its message, and its place.

    Parameters
    ----------
    error : BaseException
        The error.

    Returns
    -------
    str
        The line.
    """
    said = shown(" ".join(str(error).split()), LONGEST)
    place = place_of(error)
    return f"{type(error).__name__}{': ' if said else ''}{said}{f' ({place})' if place else ''}"


def report_error(error: BaseException, program: str) -> None:
    """Write the line of an error that ends a program, or a thread of it, to the standard error.

    Parameters
    ----------
    error : BaseException
        The error.
    program : str
        Name of the program.
    """
    if os.environ.get(TRACEBACK):
        write_error("".join(traceback.format_exception(error)))
    if isinstance(error, UserError):
        write_error(f"{program}: error: {printable(str(error))}\n")
    elif isinstance(error, OSError) and error.strerror:  # about the machine, and mostly self-explanatory
        names = ", ".join(str(name) for name in (error.filename, error.filename2) if name is not None)
        write_error(f"{program}: error: {error.strerror}{f': {names}' if names else ''} ({place_of(error)})\n")
    else:
        write_error(f"{program}: error: internal: {described(error)}; {TRACEBACK}=1 shows the traceback\n")


def catch_all(program: str, stopped: str = "") -> None:
    """Report every error that nothing else catches in this process by `report_error`; for programs only.

    Closed standard streams are opened on the null device: writing to them must neither fail nor go to another file.

    Parameters
    ----------
    program : str
        Name of the program.
    stopped : str, optional
        What Ctrl-C leaves of its work, which is written; empty where another program writes that.
    """
    for name, number in (("stdin", 0), ("stdout", 1), ("stderr", 2)):
        if getattr(sys, name) is None:
            _open_on_nothing(name, number)

    def uncaught(_: type[BaseException], error: BaseException, __: TracebackType | None) -> None:
        if not isinstance(error, KeyboardInterrupt):
            report_error(error, program)
        elif stopped:
            write_error(f"{program}: stopped; {stopped}\n")

    def in_thread(given: threading.ExceptHookArgs) -> None:
        if given.exc_value is not None:
            report_error(given.exc_value, program)

    def unraisable(given: sys.UnraisableHookArgs) -> None:
        if given.exc_value is not None and not isinstance(given.exc_value, (KeyboardInterrupt, BrokenPipeError)):
            report_error(given.exc_value, program)

    sys.excepthook, threading.excepthook, sys.unraisablehook = uncaught, in_thread, unraisable


def _open_on_nothing(name: str, number: int) -> None:
    opened = os.open(os.devnull, os.O_RDWR)
    if opened != number:
        os.dup2(opened, number)
        os.close(opened)
    setattr(sys, name, open(number, "r" if name == "stdin" else "w", closefd=False))  # noqa: SIM115


def write_error(text: str) -> None:
    """Write text to the standard error, or nowhere when it is not read: a process that ends must not fail at that."""
    try:
        sys.stderr.write(text)
        sys.stderr.flush()
    except (OSError, ValueError, AttributeError):  # a full, closed or missing stream can't be reported
        pass
