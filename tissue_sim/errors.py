"""Errors that reach a user: one line that names the cause and the remedy."""

import os
import select
import sys


class UserError(Exception):
    """Invalid use or input, reported in one line.

    The command line prints the message and exits with code 2; the node logs it and continues.
    """


def shown(text: str, longest: int = 60) -> str:
    """Return external text for a message: short, and without control characters.

    Parameters
    ----------
    text : str
        The text.
    longest : int, optional
        Number of characters after which it is cut.

    Returns
    -------
    str
        The printable text.
    """
    return printable(text if len(text) <= longest else f"{text[:longest]}...")


def printable(text: str) -> str:
    """Return text in one line, without control characters.

    Parameters
    ----------
    text : str
        The text.

    Returns
    -------
    str
        The printable text.
    """
    return (
        text
        if text.isprintable()
        else "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)
    )


def output_is_gone() -> bool:
    """Return whether the reader of the standard output has closed it, as `head` does."""
    looked = select.poll()
    looked.register(sys.stdout.fileno(), select.POLLERR)
    return bool(looked.poll(0))


def stop_output() -> None:
    """Discard the standard output after a BrokenPipeError: what is still printed or flushed would fail."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
