"""Rows of a benchmark: reported as they come, and kept when Ctrl-C ends the measurement.

Measurements run in `until_stopped`, take their items from `each`, and report every row by `report`. Ctrl-C then leaves
the rows that there are, later parts have nothing to measure, and the table says that it was stopped.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager

from tissue_sim import interrupts, progress


class _Measured:
    """Whether anything was measured in this process, and whether it was stopped."""

    any = False
    stopped = False


_measured = _Measured()


def begin() -> None:
    """Forget what was measured before."""
    _measured.any = _measured.stopped = False


def keep() -> None:
    """Note that something has been measured that Ctrl-C should leave."""
    _measured.any = True


def report(name: str, *figures: str) -> None:
    """Report a row that has been measured."""
    keep()
    progress.say(f"{name}: {', '.join(figures)}" if figures else name)


@contextmanager
def until_stopped() -> Iterator[None]:
    """Leave this block on Ctrl-C, and continue after it where something has been measured."""
    try:
        yield
    except (KeyboardInterrupt, Exception) as error:
        if not interrupts.caused(error):
            raise
        if not _measured.any:
            raise KeyboardInterrupt from None
        interrupts.reported()  # by the table
        stop()


def each[Item](items: Iterable[Item], name: str, total: int | None = None) -> Iterator[Item]:
    """Yield what is to be measured, with progress; nothing once it was stopped.

    total: number of items, where they have no length.
    """
    if not _measured.stopped:
        yield from progress.steps(items, name, total)


def stop() -> None:
    """Note that Ctrl-C ended the measurement."""
    _measured.stopped = True


def stopped() -> bool:
    """Return whether Ctrl-C ended the measurement."""
    return _measured.stopped
