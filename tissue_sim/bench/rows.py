"""Rows of a benchmark: told as they come, and kept when Ctrl-C ends the measuring.

What is measured stands in `until_stopped`, takes what is to be measured from `each`, and tells every row by `tell`.
Ctrl-C then leaves the rows that there are, what follows has nothing to measure, and the table says that it was stopped.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager

from tissue_sim import progress


class _Measured:
    """What has been measured in this process."""

    any = False
    stopped = False


_measured = _Measured()


def begin() -> None:
    """Forget what was measured before."""
    _measured.any = _measured.stopped = False


def keep() -> None:
    """Note that something has been measured, which Ctrl-C is to leave."""
    _measured.any = True


def tell(name: str, *figures: str) -> None:
    """Tell of a row that has been measured."""
    keep()
    progress.say(f"{name}: {', '.join(figures)}" if figures else name)


@contextmanager
def until_stopped() -> Iterator[None]:
    """Leave what is in here with Ctrl-C, and go on after it where something has been measured."""
    try:
        yield
    except KeyboardInterrupt:
        if not _measured.any:
            raise
        stop()


def each[Item](items: Iterable[Item], name: str, total: int | None = None) -> Iterator[Item]:
    """What is to be measured, with its progress; nothing once it was stopped."""
    if not _measured.stopped:
        yield from progress.steps(items, name, total)


def stop() -> None:
    """Note that Ctrl-C ended the measuring."""
    _measured.stopped = True


def stopped() -> bool:
    """Whether Ctrl-C ended the measuring."""
    return _measured.stopped
