"""What the parts of the node have to tell once a second."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, Protocol

MOST_LINES = 8  # about one part's troubles, that are kept


@dataclass
class Report:
    """Collected from every part in turn.

    problems are counters that are a warning when they have grown since the last report; warnings are lines
    about what is wrong now; a failure means that a part doesn't do its work.
    """

    values: dict[str, Any] = field(default_factory=dict)
    problems: dict[str, int] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)
    failures: list[str] = field(default_factory=list)


class Reports(Protocol):
    """A part of the node that has something to tell."""

    def report(self, report: Report) -> None:
        """Add to the report what there is to tell."""


class Trouble:
    """What goes wrong in a thread that goes on all the same: told once, counted, and over when it works again.

    part: the thread's name; warn takes the line.
    """

    def __init__(self, part: str, warn: Callable[[str], object]) -> None:
        self._part, self._warn = part, warn
        self._count = 0
        self._lines: tuple[str, ...] = ()  # what went wrong since it last worked; replaced as a whole

    @contextmanager
    def noted(self) -> Iterator[None]:
        """What fails in here is noted, and the thread goes on."""
        try:
            yield
        except Exception as error:  # whatever it is: nothing else of the thread's may end with it
            self._failed(error)

    def _failed(self, error: Exception) -> None:
        self._count += 1
        line = f"{self._part} failed: {type(error).__name__}: {error}"
        if line not in self._lines:  # not one for every turn
            self._warn(line)
            self._lines = (*self._lines, line)[-MOST_LINES:]

    def succeeded(self) -> None:
        """It works."""
        self._lines = ()

    def report(self, report: Report) -> None:
        """Add the count, and what is wrong at present."""
        report.problems[f"{self._part.replace(' ', '_')}_failures"] = self._count
        report.failures += self._lines
