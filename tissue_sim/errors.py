"""Errors that reach a user: one line that names the thing and the remedy."""


class UserError(Exception):
    """Wrong use or bad input, told in one line.

    The command line prints the message and exits with code 2; the node logs it and goes on.
    """
