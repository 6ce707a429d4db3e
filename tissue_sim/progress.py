"""Progress of a long calculation: a bar on a terminal, and elsewhere a line now and then.

All of it goes to the standard error; the standard output is for results.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sized
from contextlib import contextmanager

from tissue_sim.progress_reporter import Reporter


class Task:
    """Piece of work in progress.

    Parameters
    ----------
    name : str
        Name of the work.
    total : float | None
        Number of steps; None where it isn't known.
    unit : str, optional
        `%` where steps are fractions.
    """

    def __init__(self, name: str, total: float | None, unit: str = "") -> None:
        self.name, self.total, self.unit = name, total, unit
        self.done, self.remark = 0.0, ""
        self.started = time.monotonic()

    def advance(self, steps: float = 1, remark: str = "") -> None:
        """Note that `steps` more steps are done; a remark stays until the next one."""
        self.reach(self.done + steps, remark)

    def reach(self, done: float, remark: str = "") -> None:
        """Note how many steps are done in total, and report it when it is due."""
        self.done, self.remark = done, remark or self.remark
        _reporter.look()

    @property
    def counted(self) -> bool:
        """Whether it has steps that are worth counting."""
        return self.total is not None and self.total > 1

    @property
    def text(self) -> str:
        """Its name, and how much of it is done."""
        if not self.counted or self.total is None:
            return self.name
        if self.unit == "%":
            return f"{self.name} {100 * self.done / self.total:.0f} %"
        return f"{self.name} {self.done:g} of {self.total:g}"


@contextmanager
def task(name: str, total: float | None = None, unit: str = "") -> Iterator[Task]:
    """Report the progress of a piece of work while entered, also within its steps; see Task.

    Parameters
    ----------
    name : str
        Name of the work.
    total : float | None, optional
        Number of steps; None where it isn't known.
    unit : str, optional
        `%` where steps are fractions.

    Yields
    ------
    Iterator[Task]
        The task.
    """
    one = Task(name, total, unit)
    _reporter.begin(one)
    try:
        yield one
    finally:
        _reporter.end(one)


def steps[Item](items: Iterable[Item], name: str, total: int | None = None) -> Iterator[Item]:
    """Yield items, each of which is a step of a task.

    Parameters
    ----------
    items : Iterable[Item]
        The items.
    name : str
        Name of the work.
    total : int | None, optional
        Number of items, where they have no length.

    Yields
    ------
    Iterator[Item]
        One item.
    """
    if total is None and isinstance(items, Sized):
        total = len(items)
    with task(name, total) as one:
        for item in items:
            yield item
            one.advance()


def say(line: str) -> None:
    """Write a line to the standard error, above the bar.

    Parameters
    ----------
    line : str
        The line.
    """
    print(line, file=sys.stderr, flush=True)
    _reporter.postpone()


@contextmanager
def still() -> Iterator[None]:
    """Stop the progress thread while entered, as while something is timed; progress is then reported between steps."""
    with _reporter.held(1):
        yield


@contextmanager
def moving() -> Iterator[None]:
    """Allow the progress thread within `still`, for a step that takes long."""
    with _reporter.held(-1):
        yield


def report_by(write: Callable[[str], object] | None) -> None:
    """Pass lines to a function instead, such as a log's.

    Parameters
    ----------
    write : Callable[[str], object] | None
        The function; None to report nothing any more.
    """
    _reporter.write_by(write)


def name_of_all() -> str:
    """Return the name of the outermost task; empty where there is none."""
    return _reporter.name_of_all()


class Stages:
    """Stages of a long calculation: each is a task, and reports its result in a line."""

    @contextmanager
    def stage(self, name: str, total: int) -> Iterator[Callable[..., None]]:
        """Start a stage; see calibration.progress.Progress."""
        with task(name, total) as one:
            yield lambda remark="": one.advance(1, remark)
        seconds = time.monotonic() - one.started
        say(f"{name}: {one.remark + ', ' if one.remark else ''}{seconds:.1f} s")


_reporter = Reporter()
os.register_at_fork(after_in_child=_reporter.__init__)  # type: ignore[misc]  # its thread stays with the parent
