"""A child process that uses hostile input, as it may crash, hang or take all memory, and the input that it gets.

An input is used, or refused with one line. Everything else is a failure: another error, a crash, a warning, too much
time or memory, and whatever happens outside of the input's folder. The folder still has the input afterwards.
"""

import contextlib
import faulthandler
import gc
import multiprocessing
import os
import re
import resource
import shutil
import signal
import sys
import tempfile
import warnings
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, NamedTuple, Self

from helpers.fuzz.watch import Watch
from tissue_sim.errors import UserError, shown
from tissue_sim.memory import limited
from tissue_sim.parent_exit import exit_with_parent
from tissue_sim.unexpected_errors import described

PREPARING = 600.0  # s that it may take until an input is ready: imports, and kernels the first time
MEGABYTES = 400.0  # that the use of an input may take
SPARE = 1024  # MB that it may reserve beyond that, before an allocation fails
LONGEST_LINE = 1000  # characters
OUTSIDE = "outside"  # file that an input may name, and that must not be opened
_INPUT, _SCRATCH, _PRINTED, _CRASH = "input", "scratch", "printed", "crash"
_NO_MEMORY = re.compile(r"MemoryError|bad_alloc|[Aa]llocat(?!ed' value)|out of memory")
_HIDDEN = (ResourceWarning, DeprecationWarning, PendingDeprecationWarning, ImportWarning)  # by Python from users
_MB = 1024.0 * 1024.0
_CONTEXT = multiprocessing.get_context("spawn")  # a fork would start with this process's threads and memory

Ready = Callable[[], str]


class Input(NamedTuple):
    """Hostile files, which of them is read, and what prepares its use in the child: a function of its path."""

    files: dict[str, bytes | None]  # by their names in the input's folder; None: a folder
    name: str
    prepare: Callable[..., Ready]
    options: tuple = ()

    def __repr__(self) -> str:
        sizes = {name: "a folder" if data is None else f"{len(data)} bytes" for name, data in self.files.items()}
        return f"{self.prepare.__module__}.{self.prepare.__name__}({self.name!r}, *{self.options}), of {sizes}"


class Child:
    """The process, which is begun with its first input and begun again after a crash."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._process: Any = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def read(self, given: Input, seconds: float = 60.0) -> str:
        """Return 'used' or 'refused', as `use`."""
        shutil.rmtree(self.folder / _INPUT, ignore_errors=True)
        (self.folder / _INPUT).mkdir()
        for name, data in given.files.items():
            path = self.folder / _INPUT / name
            path.parent.mkdir(exist_ok=True)
            if data is None:
                path.mkdir(exist_ok=True)
            else:
                path.write_bytes(data)
        return self.use(given.prepare, self.folder / _INPUT / given.name, *given.options, seconds=seconds)

    def use(self, prepare: Callable[..., Ready], *arguments: Any, seconds: float = 60.0) -> str:
        """Let it prepare something, and use it within some seconds; return 'used' or 'refused'.

        Raises AssertionError for anything else.
        """
        self._begin()
        self._pipe.send((prepare, arguments))
        outcome, patience = None, PREPARING
        while outcome is None:
            if not self._pipe.poll(patience):
                os.kill(self._process.pid, signal.SIGABRT)  # the fault handler reports where it is
                raise AssertionError(self._end(f"hung: not finished after {patience:.0f} s"))
            try:
                outcome, patience = self._pipe.recv(), seconds
            except (EOFError, ConnectionError):
                raise AssertionError(self._end("")) from None
        verdict, line = outcome
        assert verdict != "failed", line
        return verdict

    def _begin(self) -> None:
        if self._process is not None and self._process.is_alive():
            return
        self.stop()
        self._pipe, other = _CONTEXT.Pipe()
        self._process = _CONTEXT.Process(target=_serve, args=(other, self.folder), daemon=True)
        self._process.start()
        other.close()

    def _end(self, reason: str) -> str:
        """Return why it has died, or the reason why it shall, and its innermost Python line or its last words."""
        self._process.join(5.0)
        code = self._process.exitcode or 0
        died = f"the process died of {signal.Signals(-code).name}" if code < 0 else f"the process ended with {code}"
        self.stop()
        frames = [line for line in _lines(self.folder / _CRASH) if line.startswith("File ")]
        return f"{reason or died} ({(frames or _lines(self.folder / _PRINTED)[-1:] or ['no words'])[0]})"

    def stop(self) -> None:
        """End it, if it runs."""
        if self._process is None:
            return
        self._pipe.close()
        self._process.join(10.0)  # it ends what it has begun
        self._process.kill()
        self._process.join()
        self._process = None


def _lines(path: Path) -> list[str]:
    text = path.read_text(encoding="utf-8", errors="replace") if path.exists() else ""
    return [line.strip() for line in text.splitlines() if line.strip()]


# in the child -----------------------------------------------------------------------------------------

_warm: set[Callable] = set()  # what has prepared an input before


def _serve(pipe: Connection, folder: Path) -> None:
    """Use one input after the other: None goes out when it is ready, and then its outcome."""
    exit_with_parent()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.chdir(folder)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    printed = os.open(_PRINTED, os.O_RDWR | os.O_CREAT | os.O_APPEND | os.O_TRUNC)
    for stream in (1, 2):  # also of libraries
        os.dup2(printed, stream)
    with Path(_CRASH).open("w", encoding="utf-8") as crash:
        faulthandler.enable(crash)
        watch = Watch(folder)
        while True:
            try:
                prepare, arguments = pipe.recv()
            except EOFError:
                return
            outcome = _prepared(folder, prepare, arguments)
            if not isinstance(outcome, tuple):
                pipe.send(None)
                outcome = _trial(outcome, watch, printed)
            pipe.send(outcome)


def _prepared(folder: Path, prepare: Callable[..., Ready], arguments: tuple) -> Ready | tuple[str, str]:
    """Return what uses the input, or the outcome of a failure."""
    shutil.rmtree(folder / _SCRATCH, ignore_errors=True)
    (folder / _SCRATCH).mkdir()
    tempfile.tempdir = str(folder / _SCRATCH)
    (folder / OUTSIDE).write_bytes(b"secret " * 1000)
    try:
        ready = prepare(*arguments)
    except Exception as error:
        return "failed", f"not even prepared: {described(error)}"
    gc.collect()
    if prepare not in _warm:
        _warm.add(prepare)
        gc.freeze()  # what is loaded now stays, so that no collection scans it again
    return ready


def _trial(ready: Ready, watch: Watch, printed: int) -> tuple[str, str]:
    """Use an input; return 'used', 'refused' or 'failed', and a line."""
    sys.stdout.flush()
    sys.stderr.flush()
    os.ftruncate(printed, 0)
    watch.seen(frozenset())
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")  # resets the peak
    before = _peak_memory()
    with limited(round((MEGABYTES + SPARE) * _MB)):
        watch.armed = True
        verdict, line = _verdict(ready)
        watch.armed = False
    taken = _peak_memory() - before
    sys.stdout.flush()
    sys.stderr.flush()
    wrong = "" if verdict == "failed" else _wrong(verdict, line, taken, watch)
    return ("failed", wrong) if wrong else (verdict, line)


def _verdict(ready: Ready) -> tuple[str, str]:
    with warnings.catch_warnings():
        warnings.simplefilter("always")  # a warning shows each time, whatever came before
        for category in _HIDDEN:
            warnings.simplefilter("ignore", category)
        try:
            return "used", ready()
        except UserError as error:
            return "refused", str(error)
        except BaseException as error:
            return "failed", shown(described(error), 300)


def _wrong(verdict: str, line: str, taken: float, watch: Watch) -> str:
    """Return what is wrong with an input that was used or refused; empty where nothing is."""
    if seen := watch.seen(frozenset({_INPUT, _SCRATCH, _PRINTED, _CRASH})):
        return "; ".join(seen)
    if taken > MEGABYTES:
        return f"took {taken:.0f} MB: {line}"
    if verdict == "refused":
        if not line.strip() or "\n" in line or len(line) > LONGEST_LINE:
            return f"refused with {line.count(chr(10)) + 1} lines of {len(line)} characters: {line[:100]!r}"
        if _NO_MEMORY.search(line):
            return f"requested more memory than available: {line}"
    said = _lines(Path(_PRINTED))
    return f"something else was printed: {said[0]}" if said else ""


def _peak_memory() -> float:
    """Return the peak MB in use since the last reset."""
    found = re.search(r"VmHWM:\s*(\d+) kB", Path("/proc/self/status").read_text())
    return int(found[1]) / 1024.0 if found else 0.0
