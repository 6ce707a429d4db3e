"""Errors that reach a user: one line that names the thing and the remedy."""

import os
import select
import sys


class UserError(Exception):
    """Wrong use or bad input, told in one line.

    The command line prints the message and exits with code 2; the node logs it and goes on.
    """


def shown(text: str, longest: int = 60) -> str:
    """What comes from outside as a line may have it: short, and without what a terminal would obey."""
    return printable(text if len(text) <= longest else f"{text[:longest]}...")


def printable(text: str) -> str:
    """Text in one line, without what a terminal would obey."""
    return (
        text
        if text.isprintable()
        else "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)
    )


def output_is_gone() -> bool:
    """Whether who read the standard output has closed it, as `head` does."""
    looked = select.poll()
    looked.register(sys.stdout.fileno(), select.POLLERR)
    return bool(looked.poll(0))


def give_up_output() -> None:
    """After a BrokenPipeError: what is still to be printed, and flushed at the end, has nowhere to go."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
