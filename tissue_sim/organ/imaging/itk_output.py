"""Suppression of what libraries below Python print about a damaged image; users get one line of ours instead."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

_STREAMS = 1, 2  # the process's own


@contextmanager
def silenced() -> Iterator[None]:
    """Discard everything that this process prints while entered; not for use beside threads that print."""
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


def _is_open(number: int) -> bool:
    try:
        os.fstat(number)
    except OSError:
        return False
    return True
