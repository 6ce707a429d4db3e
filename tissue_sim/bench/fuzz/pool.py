"""Pool of processes that run cases; those that die or hang are noticed and restarted."""

from __future__ import annotations

import multiprocessing
import os
import signal
import tempfile
import time
from collections.abc import Iterator, Sequence
from multiprocessing.connection import Connection, wait
from pathlib import Path

from tissue_sim.bench.fuzz.cases import KINDS, Case, Outcome
from tissue_sim.bench.fuzz.trial import Trial, remains_of
from tissue_sim.parent_exit import exit_with_parent

PREPARING = 600.0  # s that a case may take until its input is ready: imports, and kernels the first time
_LOOK_EVERY = 0.5  # s

_CONTEXT = multiprocessing.get_context("spawn")  # a fork would start with this process's threads and memory


def _serve(pipe: Connection, folder: str) -> None:
    """Run cases as a worker: a case comes in; None goes out when its input is ready, and then its outcome."""
    exit_with_parent()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C ends the command, which ends the workers
    trial = Trial(Path(folder))
    while True:
        try:
            case = pipe.recv()
        except EOFError:
            return
        pipe.send(trial.run(case, lambda: pipe.send(None)))


class _Worker:
    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self.case: Case | None = None
        self._start()

    def _start(self) -> None:
        self._own = tempfile.TemporaryDirectory(dir=self._folder)
        self.pipe, other = _CONTEXT.Pipe()
        self._process = _CONTEXT.Process(target=_serve, args=(other, self._own.name), daemon=True)
        self._process.start()
        other.close()

    def give(self, case: Case) -> None:
        """Let it run a case."""
        try:
            self.pipe.send(case)
        except OSError:  # it has died since its last case
            self.stop()
            self._start()
            self.pipe.send(case)
        self.case, self._started, self._patience = case, time.monotonic(), PREPARING

    def outcome(self) -> Outcome | None:
        """Return the outcome of its case, if there is one; restart a worker that has died or hangs."""
        case = self.case
        assert case is not None
        if self.pipe.poll():
            try:
                found: Outcome | None = self.pipe.recv()
                if found is None:
                    self._started, self._patience = time.monotonic(), KINDS[case.kind].seconds
                else:
                    self.case = None
                return found
            except (EOFError, ConnectionError):
                return self._restarted(case, "")
        if time.monotonic() - self._started > self._patience:
            return self._restarted(case, f"hung: not finished after {self._patience:.0f} s")
        return None

    def _restarted(self, case: Case, reason: str) -> Outcome:
        seconds = time.monotonic() - self._started
        if reason:
            os.kill(self._process.pid or 0, signal.SIGABRT)  # the fault handler reports where it is
            self._process.join(2.0)
        reason = reason or self._cause()
        left = remains_of(Path(self._own.name))
        told = left.at or ("" if "died" in reason else left.words)
        self.stop()
        self._start()
        self.case = None
        return Outcome(case, "failed", f"{reason}{f' ({told})' if told else ''}", left.what, seconds)

    def _cause(self) -> str:
        self._process.join(2.0)
        code = self._process.exitcode or 0
        return f"the process died of {signal.Signals(-code).name}" if code < 0 else f"the process ended with {code}"

    def stop(self) -> None:
        """End the process."""
        self.pipe.close()
        self._process.kill()
        self._process.join()
        self._own.cleanup()


def run_cases(cases: Sequence[Case], jobs: int) -> Iterator[Outcome]:
    """Yield the outcomes of cases as they are ready.

    Parameters
    ----------
    cases : Sequence[Case]
        The cases.
    jobs : int
        Number of processes.

    Yields
    ------
    Iterator[Outcome]
        One outcome.
    """
    waiting = list(reversed(cases))
    with tempfile.TemporaryDirectory(prefix="tissue_sim_fuzz_") as folder:
        workers = [_Worker(Path(folder)) for _ in range(min(jobs, len(cases)))]
        try:
            while True:
                for worker in workers:
                    if worker.case is None and waiting:
                        worker.give(waiting.pop())
                busy = [worker for worker in workers if worker.case is not None]
                if not busy:
                    return
                wait([worker.pipe for worker in busy], timeout=_LOOK_EVERY)
                yield from (found for worker in busy if (found := worker.outcome()) is not None)
        finally:
            for worker in workers:
                worker.stop()
