"""Errors that reach a user: one line that names the thing and the remedy."""

import os
import sys


class UserError(Exception):
    """Wrong use or bad input, told in one line.

    The command line prints the message and exits with code 2; the node logs it and goes on.
    """


def give_up_output() -> None:
    """After a BrokenPipeError: what is still to be printed, and flushed at the end, has nowhere to go."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
