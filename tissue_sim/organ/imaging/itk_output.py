"""Suppression of what libraries below Python print about a damaged image, and of a locale that they leave behind."""

from __future__ import annotations

import locale
import os
from collections.abc import Iterator
from contextlib import contextmanager

_STREAMS = 1, 2  # the process's own


@contextmanager
def silenced() -> Iterator[None]:
    """Discard everything that this process prints while entered; not for use beside threads that print.

    ITK's reader of VTK images leaves the process in the locale C, in which Python can't read a text that isn't ASCII.
    """
    before = locale.setlocale(locale.LC_ALL)
    kept = [(number, os.dup(number)) for number in _STREAMS if _is_open(number)]
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        for number, _ in kept:
            os.dup2(nowhere, number)
        yield
    finally:
        os.close(nowhere)
        for number, copy in kept:
            os.dup2(copy, number)
            os.close(copy)
        locale.setlocale(locale.LC_ALL, before)


def _is_open(number: int) -> bool:
    try:
        os.fstat(number)
    except OSError:
        return False
    return True
