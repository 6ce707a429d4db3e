"""A time of a test's own, by which progress is reported."""

import pytest

from tissue_sim import progress, progress_reporter


class Clock:
    """A time that goes on when `pass_by` is called."""

    def __init__(self) -> None:
        self.now = 1000.0

    def monotonic(self) -> float:
        return self.now

    def pass_by(self, seconds: float) -> None:
        """Let time pass, as in work that reports nothing by itself."""
        self.now += seconds
        reporter = progress._reporter
        if reporter._ticker is not None:
            reporter.look()


def clock_of(monkeypatch: pytest.MonkeyPatch) -> Clock:
    """A clock by which a new reporter of progress goes, without a setting of the user's."""
    clock = Clock()
    monkeypatch.setattr(progress, "time", clock)
    monkeypatch.setattr(progress_reporter, "time", clock)
    monkeypatch.setattr(progress, "_reporter", progress.Reporter())
    monkeypatch.setenv(progress_reporter.SETTING, "")
    return clock
