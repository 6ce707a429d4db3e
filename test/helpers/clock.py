"""A time of a test's own, by which progress is reported."""

import pytest

from tissue_sim import progress


class Clock:
    """A time that goes on when it is told to."""

    def __init__(self) -> None:
        self.now = 1000.0

    def monotonic(self) -> float:
        return self.now

    def pass_by(self, seconds: float) -> None:
        """Let time pass, as in work that reports nothing by itself."""
        self.now += seconds
        teller = progress._teller
        if teller._ticker is not None:
            teller.look()


def clock_of(monkeypatch: pytest.MonkeyPatch) -> Clock:
    """A clock by which a new reporter of progress goes, without a setting of the user's."""
    clock = Clock()
    monkeypatch.setattr(progress, "time", clock)
    monkeypatch.setattr(progress, "_teller", progress._Teller())
    monkeypatch.setenv(progress.SETTING, "")
    return clock
