"""What the parts of the node have to tell once a second."""

from __future__ import annotations

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
