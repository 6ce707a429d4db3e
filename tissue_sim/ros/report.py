"""What the parts of the node have to tell once a second."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Protocol


@dataclass
class Report:
    """Collected from every part in turn.

    problems are counters that are a warning when they have grown since the last report; warnings are lines
    about what is wrong now; a failure means that a part does its work no more.
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
        self.count = 0
        self.now = ""  # what is wrong at present

    def failed(self, error: Exception) -> None:
        """Note an error."""
        self.count += 1
        line = f"{self._part} failed: {type(error).__name__}: {error}"
        if line != self.now:  # not one for every turn
            self._warn(line)
        self.now = line

    def succeeded(self) -> None:
        """It works."""
        self.now = ""

    def report(self, report: Report) -> None:
        """Add the count, and what is wrong at present."""
        report.problems[f"{self._part.replace(' ', '_')}_failures"] = self.count
        if self.now:
            report.failures.append(self.now)
