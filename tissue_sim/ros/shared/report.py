"""What the parts of the node have to tell once a second."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, Protocol

from tissue_sim.unexpected import place_of, told

MOST_LINES = 8  # about one part's troubles, that are kept
STARVED = "the physics loop hangs, or gets no processor time: no forces until it continues"


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
    parts: dict[str, Report] = field(default_factory=dict)  # of a tool or an organ, by what it is called
    before: str = ""  # of a part: what stands before its names in the whole
    state: str = "running"  # in a word, where nothing is wrong

    def part(self, called: str, before: str) -> Report:
        """The report of a tool or an organ, which is a status of its own, and in the whole as well.

        before: what stands before its names there.
        """
        return self.parts.setdefault(called, Report(before=before))

    def whole(self) -> Report:
        """This report with all that its parts have; the lines of these come first."""
        parts = list(self.parts.values())
        return Report(
            self.values | {f"{one.before}{name}": value for one in parts for name, value in one.values.items()},
            self.problems | {f"{one.before}{name}": count for one in parts for name, count in one.problems.items()},
            [line for one in parts for line in one.warnings] + self.warnings,
            [line for one in parts for line in one.failures] + self.failures,
        )


class Reports(Protocol):
    """A part of the node that has something to tell."""

    def report(self, report: Report) -> None:
        """Add to the report what there is to tell."""


class Mishaps:
    """What goes wrong where nobody thought of it, while the node goes on: told once for each place, and counted.

    part: what fails, in words; warn takes the line.
    """

    def __init__(self, part: str, warn: Callable[[str], object]) -> None:
        self._part, self._warn = part, warn
        self._key = f"{part.replace(' ', '_')}_failures"
        self._counts: Counter[str] = Counter()  # by place
        self._lock = threading.Lock()

    @contextmanager
    def noted(self) -> Iterator[None]:
        """What fails in here is noted, and the thread goes on."""
        try:
            yield
        except Exception as error:  # whatever it is: nothing else of the thread's may end with it
            self.note(error)

    def note(self, error: BaseException) -> str:
        """Note an error; returns its line."""
        place, line = place_of(error), f"{self._part} failed: {told(error)}"
        with self._lock:
            self._counts[place] += 1
            is_new = self._is_new(place, line)
        if is_new:
            self._warn(line)
        return line

    def report(self, report: Report) -> None:
        """Add how much went wrong, and where."""
        with self._lock:
            counts = dict(self._counts)
        report.problems[self._key] = sum(counts.values())
        report.problems |= {f"{self._key}.{place}": count for place, count in counts.items()}

    def _is_new(self, place: str, line: str) -> bool:
        """Whether nobody was told."""
        return self._counts[place] == 1


class Trouble(Mishaps):
    """What goes wrong in a thread that does the same again and again: over when it works, and then told anew."""

    def __init__(self, part: str, warn: Callable[[str], object]) -> None:
        super().__init__(part, warn)
        self._lines: dict[str, str] = {}  # what goes wrong, by place
        self._lately: set[str] = set()  # places where something did since the part last went through its work

    def succeeded(self) -> None:
        """It went through its work: what has not failed since it last did is over."""
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
