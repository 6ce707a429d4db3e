"""Reporting of progress: by a bar on a terminal, and elsewhere by a line now and then; for the tasks of `progress`."""

from __future__ import annotations

import math
import os
import shutil
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Protocol, TextIO

from tissue_sim.errors import UserError

SETTING = "TISSUE_SIM_PROGRESS"  # s between lines where there is no terminal; 0: neither lines nor bars
FIRST, PERIOD = 3.0, 10.0  # s until the first line, and between lines
REDRAW = 0.5  # s until a terminal shows a bar, and between updates
PAUSE = 1.0  # s without any task, after which the next one counts as a new beginning


class Reported(Protocol):
    """A task in progress, as `progress.Task` is."""

    name: str
    total: float | None
    unit: str
    done: float
    remark: str
    started: float

    @property
    def counted(self) -> bool:
        """Whether it has steps that are worth counting."""

    @property
    def text(self) -> str:
        """Its name, and how much of it is done."""


class _Above:
    """Stream of the terminal while a bar is shown there: text is written above the bar."""

    def __init__(self, stream: TextIO, reporter: Reporter) -> None:
        self._stream, self._reporter = stream, reporter

    def write(self, text: str) -> int:
        with self._reporter.lock:
            self._reporter.wipe()
            count = self._stream.write(text)
            if text:
                self._reporter.inside_line = not text.endswith("\n")
            self._stream.flush()  # before the bar is drawn again
            return count

    def __getattr__(self, name: str) -> object:
        return getattr(self._stream, name)


class Reporter:
    """Reporter of the innermost task: one for each process."""

    def __init__(self) -> None:
        self.lock = threading.RLock()
        self.terminal: TextIO | None = None  # where a bar is drawn
        self.inside_line = False  # whether half a line was written to the terminal
        self._tasks: list[Reported] = []
        self._write: Callable[[str], object] | None = _to_stderr
        self._due, self._period, self._ended = math.inf, PERIOD, -math.inf
        self._drawn = 0  # columns of the bar that is shown
        self._holds = 0
        self._ticker: tuple[threading.Thread, threading.Event] | None = None

    # tasks ---------------------------------------------------------------------------------------

    def begin(self, one: Reported) -> None:
        """Report a task, which is the innermost one, from now on."""
        with self.lock:
            if not self._tasks:
                self._choose()
            self._tasks.append(one)
            self._run()

    def end(self, one: Reported) -> None:
        """Report a task no longer."""
        with self.lock:
            if one in self._tasks:  # not after a fork
                self._tasks.remove(one)
            if not self._tasks:
                self._stop()
                self._ended = time.monotonic()
                self._leave_terminal()

    def name_of_all(self) -> str:
        """Return the name of the outermost task; empty where there is none."""
        with self.lock:
            return self._tasks[0].name if self._tasks else ""

    def write_by(self, write: Callable[[str], object] | None) -> None:
        """Pass lines to a function from now on; None to report nothing any more."""
        with self.lock:
            self._write = write
            if self._tasks:
                self._leave_terminal()
                self._choose()
                self._run()

    def _choose(self) -> None:
        """Choose where and how often to report."""
        interval = _interval()
        if self._write is None or sys.stderr is None or interval == 0.0:
            self._due = math.inf
            return
        first, self._period = min(FIRST, interval), interval
        if self._write is _to_stderr and sys.stderr.isatty():
            first = self._period = min(REDRAW, interval)
            self._take_terminal(sys.stderr)
        now = time.monotonic()
        if now - self._ended > PAUSE or self._due == math.inf:
            self._due = now + first

    # the thread ----------------------------------------------------------------------------------

    @contextmanager
    def held(self, change: int) -> Iterator[None]:
        """Stop the thread, or let it run again, while entered."""
        self._hold(change)
        try:
            yield
        finally:
            self._hold(-change)

    def _hold(self, change: int) -> None:
        with self.lock:
            self._holds += change
            self.wipe()
            ticker = self._ticker
            if self._holds > 0:
                self._stop()
            else:
                self._run()
        if self._holds > 0 and ticker is not None:
            ticker[0].join()

    def _run(self) -> None:
        """Start the thread where there is something to report and nothing that it would disturb."""
        if self._ticker is None and self._tasks and self._holds <= 0 and self._due < math.inf:
            ended = threading.Event()
            thread = threading.Thread(target=self._tick, args=(ended,), name="progress", daemon=True)
            self._ticker = thread, ended
            thread.start()

    def _stop(self) -> None:
        if self._ticker is not None:
            self._ticker[1].set()
            self._ticker = None

    def _tick(self, ended: threading.Event) -> None:
        while not ended.wait(min(max(self._due - time.monotonic(), 0.02), PERIOD)):
            self.look(ended)

    # reporting ---------------------------------------------------------------------------------

    def look(self, ended: threading.Event | None = None) -> None:
        """Report how far the innermost task is, where that is due; ended: event of the thread that asks."""
        if time.monotonic() < self._due:
            return
        with self.lock:
            now = time.monotonic()
            if now < self._due or not self._tasks or (ended is not None and ended.is_set()):
                return
            self._due = now + self._period
            with suppress(OSError, ValueError):  # a full disk or a closed stream isn't reported
                if self.terminal is not None:
                    self._draw(now)
                elif self._write is not None:
                    self._write(self._line(now))

    def postpone(self) -> None:
        """Note that something else was reported now."""
        with self.lock:
            if self.terminal is None and self._due < math.inf:
                self._due = time.monotonic() + self._period

    def _path(self) -> str:
        first, *others = (one.text for one in self._tasks)
        return f"{first}: {', '.join(others)}" if others else first

    def _line(self, now: float) -> str:
        """Return name, steps, remark, elapsed and remaining time."""
        one = self._tasks[-1]
        seconds = now - one.started
        line = f"{self._path()}{', ' + one.remark if one.remark else ''}; {_clock(seconds)}"
        if one.counted and one.total is not None and one.done:
            line += f", about {_clock(seconds * max(one.total - one.done, 0.0) / one.done)} left"
        return line

    # the terminal --------------------------------------------------------------------------------

    def _take_terminal(self, terminal: TextIO) -> None:
        self.terminal, self._drawn, self.inside_line = terminal, 0, False
        for name in ("stdout", "stderr"):
            stream = getattr(sys, name)
            if stream is not None and stream.isatty():
                setattr(sys, name, _Above(stream, self))

    def _leave_terminal(self) -> None:
        if self.terminal is None:
            return
        self.wipe()
        for name in ("stdout", "stderr"):
            stream = getattr(sys, name)
            if isinstance(stream, _Above):
                setattr(sys, name, stream._stream)
        self.terminal = None

    def wipe(self) -> None:
        """Remove the bar, until it is drawn again."""
        if self.terminal is not None and self._drawn:
            with suppress(OSError, ValueError):
                self.terminal.write(f"\r{' ' * self._drawn}\r")
                self.terminal.flush()
        self._drawn = 0

    def _draw(self, now: float) -> None:
        if self.terminal is None or self.inside_line:
            return
        from tqdm import tqdm

        one, columns = self._tasks[-1], shutil.get_terminal_size().columns - 1
        seconds = now - one.started
        if one.counted and one.total is not None:
            path = self._path().removesuffix(one.text) + one.name
            count = "" if one.unit == "%" else f" {one.done:g}/{one.total:g}"
            shape = "{l_bar}{bar}|" + count + " [{elapsed}<{remaining}{postfix}]"
            line = tqdm.format_meter(
                one.done, one.total, seconds, ncols=columns, prefix=path, postfix=one.remark, bar_format=shape
            )
        else:
            line = f"{self._path()}: {_clock(seconds)}{', ' + one.remark if one.remark else ''}"
        line = line[:columns]
        self.terminal.write(f"\r{line.ljust(self._drawn)}")
        self.terminal.flush()
        self._drawn = len(line)


def _to_stderr(line: str) -> None:
    sys.stderr.write(f"{line}\n")
    sys.stderr.flush()


def _clock(seconds: float) -> str:
    """Return minutes and seconds, with hours before them where there are some."""
    minutes, left = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{left:02}" if hours else f"{minutes:02}:{left:02}"


def _interval() -> float:
    """Return the seconds between lines. Raises UserError where the setting is invalid."""
    text = os.environ.get(SETTING, "")
    if not text:
        return PERIOD
    try:
        seconds = float(text)
    except ValueError:
        seconds = math.nan
    if not 0.0 <= seconds < math.inf:
        raise UserError(f"{SETTING}={text}: use the seconds between two lines of progress, such as 60, or 0 for none")
    return seconds
