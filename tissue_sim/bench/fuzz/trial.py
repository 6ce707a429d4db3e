"""Trials of one case after the other in a process that may die of one: used, refused, or failed."""

from __future__ import annotations

import contextlib
import faulthandler
import gc
import os
import re
import resource
import shutil
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from tissue_sim.bench.fuzz.cases import KINDS, Broken, Case, Input, Kind, Outcome, Verdict
from tissue_sim.bench.fuzz.side_effects import Watch
from tissue_sim.errors import UserError, shown
from tissue_sim.memory import limited
from tissue_sim.unexpected_errors import told

INPUT, SCRATCH, PRINTED, CRASH, WHAT = "input", "scratch", "printed", "crash", "what"  # in a worker's folder
OUTSIDE = "outside"  # file there that an input may name, and that must not be opened
LONGEST_LINE = 1000  # characters
SPARE = 1024  # MB that a case may reserve beyond what it may use, before an allocation fails
_NO_MEMORY = re.compile(r"MemoryError|bad_alloc|[Aa]llocat(?!ed' value)|out of memory")
_MB = 1024.0 * 1024.0
_HIDDEN = (ResourceWarning, DeprecationWarning, PendingDeprecationWarning, ImportWarning)  # by Python from users


class Trial:
    """Runner of cases in its own folder; the process must not do anything else."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        (folder / SCRATCH).mkdir()
        os.chdir(folder)
        tempfile.tempdir = str(folder / SCRATCH)
        self._crash = (folder / CRASH).open("w")
        faulthandler.enable(self._crash)
        self._printed = os.open(folder / PRINTED, os.O_RDWR | os.O_CREAT | os.O_APPEND)
        sys.stdout.flush()
        for stream in (1, 2):  # also of libraries
            os.dup2(self._printed, stream)
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        self._warm: set[str] = set()
        self._watch = Watch(folder)

    def run(self, case: Case, when_ready: Callable[[], object] = lambda: None) -> Outcome:
        """Make the input of a case, report that, use it, and assess the result."""
        kind = KINDS[case.kind]
        (self.folder / WHAT).unlink(missing_ok=True)
        self._clear()
        if case.kind not in self._warm:
            kind.warm_up(self.folder / INPUT)
            self._warm.add(case.kind)
            self._clear()
            gc.freeze()  # what is loaded now stays, so that no collection scans it again
        (self.folder / OUTSIDE).write_bytes(b"secret " * 1000)
        ready = kind.prepare(case, self.folder / INPUT)
        (self.folder / WHAT).write_text(ready.what, encoding="utf-8")
        gc.collect()
        when_ready()
        verdict, line, seconds, megabytes = self._used(ready, kind)
        (self.folder / OUTSIDE).unlink()
        return Outcome(case, verdict, line, ready.what, seconds, megabytes)

    def _clear(self) -> None:
        for name in (INPUT, SCRATCH):
            shutil.rmtree(self.folder / name, ignore_errors=True)
            (self.folder / name).mkdir()

    def _used(self, ready: Input, kind: Kind) -> tuple[Verdict, str, float, float]:
        os.ftruncate(self._printed, 0)
        self._watch.seen(frozenset())
        before, started = _start_of_memory(), time.perf_counter()
        with limited(round((kind.megabytes + SPARE) * _MB)):
            self._watch.armed = True
            verdict, line = _verdict(ready.use)
            self._watch.armed = False
        seconds, taken = time.perf_counter() - started, _peak_memory() - before
        sys.stdout.flush()
        sys.stderr.flush()
        if verdict != "failed":
            wrong = self._wrong(verdict, line, taken, kind)
            if wrong:
                verdict, line = "failed", wrong
        return verdict, line, seconds, taken

    def _wrong(self, verdict: Verdict, line: str, taken: float, kind: Kind) -> str:
        """Return what is wrong with an input that was used or refused; empty where nothing is."""
        own = frozenset({INPUT, SCRATCH, PRINTED, CRASH, WHAT})
        if seen := self._watch.seen(own):
            return "; ".join(seen)
        if taken > kind.megabytes:
            return f"took {taken:.0f} MB: {line}"
        if verdict == "refused":
            if not line.strip() or "\n" in line or len(line) > LONGEST_LINE:
                return f"refused with {line.count(chr(10)) + 1} lines of {len(line)} characters: {line[:100]!r}"
            if _NO_MEMORY.search(line):
                return f"requested more memory than available: {line}"
        printed = (self.folder / PRINTED).read_text(encoding="utf-8", errors="replace").split("\n", 1)[0]
        return f"something else was printed: {printed}" if printed else ""


def _verdict(use: Callable[[], str]) -> tuple[Verdict, str]:
    with warnings.catch_warnings():
        warnings.simplefilter("always")  # a warning shows each time, whatever came before
        for category in _HIDDEN:
            warnings.simplefilter("ignore", category)
        try:
            return "used", use()
        except UserError as error:
            return "refused", str(error)
        except Broken as error:
            return "failed", str(error)
        except BaseException as error:
            return "failed", shown(told(error), 300)


class Remains(NamedTuple):
    """Traces of a worker that died: its last input in a few words, its innermost Python line, its last output."""

    what: str
    at: str
    words: str


def remains_of(folder: Path) -> Remains:
    """Return the traces in a worker's folder; empty where there are none.

    Parameters
    ----------
    folder : Path
        The folder.

    Returns
    -------
    Remains
        The traces.
    """
    frames = [line for line in _lines(folder / CRASH) if line.startswith("File ")]
    return Remains(" ".join(_lines(folder / WHAT)), (frames or [""])[0], (_lines(folder / PRINTED) or [""])[-1])


def _lines(path: Path) -> list[str]:
    try:
        return [
            line.strip() for line in path.read_text(encoding="utf-8", errors="replace").splitlines() if line.strip()
        ]
    except OSError:
        return []


# memory -------------------------------------------------------------------------------------------


def _start_of_memory() -> float:
    """Return the MB in use, and reset the peak."""
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")
    return _peak_memory()


def _peak_memory() -> float:
    """Return the peak MB in use since the last reset."""
    status = Path("/proc/self/status").read_text()
    found = re.search(r"VmHWM:\s*(\d+) kB", status)
    return int(found[1]) / 1024.0 if found else 0.0
