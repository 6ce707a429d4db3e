"""Reports of the parts of the node, once a second."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Protocol

from tissue_sim.json_types import JsonObject
from tissue_sim.unexpected_errors import described, place_of

MOST_LINES = 8  # lines kept about one part's troubles
STARVED = "the physics loop hangs, or gets no processor time: no forces until it continues"


@dataclass
class Report:
    """A report, collected from every part in turn.

    Attributes
    ----------
    values : JsonObject
        Values to report, by name.
    problems : dict[str, int]
        Counters that are a warning when they have grown since the last report.
    warnings : list[str]
        Lines about what is wrong now.
    failures : list[str]
        Lines about parts that don't do their work.
    parts : dict[str, Report]
        Reports of tools or organs, by name.
    before : str
        Prefix of a part's names in the whole.
    state : str
        State in a word, where nothing is wrong.
    """

    values: JsonObject = field(default_factory=dict)
    problems: dict[str, int] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)
    failures: list[str] = field(default_factory=list)
    parts: dict[str, Report] = field(default_factory=dict)  # of a tool or an organ, by name
    before: str = ""  # prefix of a part's names in the whole
    state: str = "running"  # in a word, where nothing is wrong

    def part(self, called: str, before: str) -> Report:
        """Return the report of a tool or an organ, which is a status of its own, and in the whole as well.

        called: name of the tool or organ; before: prefix of its names in the whole.
        """
        return self.parts.setdefault(called, Report(before=before))

    def whole(self) -> Report:
        """Return this report with those of its parts; their lines come first."""
        parts = list(self.parts.values())
        return Report(
            self.values | {f"{one.before}{name}": value for one in parts for name, value in one.values.items()},
            self.problems | {f"{one.before}{name}": count for one in parts for name, count in one.problems.items()},
            [line for one in parts for line in one.warnings] + self.warnings,
            [line for one in parts for line in one.failures] + self.failures,
        )


class Reports(Protocol):
    """A part of the node that reports."""

    def report(self, report: Report) -> None:
        """Add to the report."""


class UnexpectedErrors:
    """Unforeseen errors while the node goes on: logged once for each place, and counted.

    part: what fails, in words; warn: takes the line.
    """

    def __init__(self, part: str, warn: Callable[[str], object]) -> None:
        self._part, self._warn = part, warn
        self._key = f"{part.replace(' ', '_')}_failures"
        self._counts: Counter[str] = Counter()  # by place
        self._lock = threading.Lock()

    @contextmanager
    def noted(self) -> Iterator[None]:
        """Note what fails in here, and go on."""
        try:
            yield
        except Exception as error:  # of any kind: nothing else in the thread may end with it
            self.note(error)

    def note(self, error: BaseException) -> str:
        """Note an error; return its line."""
        place, line = place_of(error), f"{self._part} failed: {described(error)}"
        with self._lock:
            self._counts[place] += 1
            is_new = self._is_new(place, line)
        if is_new:
            self._warn(line)
        return line

    def report(self, report: Report) -> None:
        """Add the number of failures, and where they occurred."""
        with self._lock:
            counts = dict(self._counts)
        report.problems[self._key] = sum(counts.values())
        report.problems |= {f"{self._key}.{place}": count for place, count in counts.items()}

    def _is_new(self, place: str, line: str) -> bool:
        """Return whether the place has not been logged yet."""
        return self._counts[place] == 1


class RepeatedFailure(UnexpectedErrors):
    """Errors in a thread that repeats its work: over when it succeeds, and then logged again."""

    def __init__(self, part: str, warn: Callable[[str], object]) -> None:
        super().__init__(part, warn)
        self._lines: dict[str, str] = {}  # line of each error, by place
        self._lately: set[str] = set()  # places of errors since the part last succeeded

    def succeeded(self) -> None:
        """Note that the work succeeded: errors that have not recurred since the last time are over."""
        with self._lock:
            self._lines = {place: line for place, line in self._lines.items() if place in self._lately}
            self._lately.clear()

    def report(self, report: Report) -> None:
        """Add the counts, and what is wrong at present."""
        super().report(report)
        with self._lock:
            report.failures += list(self._lines.values())[-MOST_LINES:]

    def _is_new(self, place: str, line: str) -> bool:
        self._lately.add(place)
        is_new = place not in self._lines  # not one for every turn
        self._lines[place] = line
        return is_new
