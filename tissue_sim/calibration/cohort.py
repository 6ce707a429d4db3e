"""Execution of many calculations, several at once, on this machine or on a Dask cluster.

Each has a process of its own, with one thread of linear algebra, so that its result is the same bits wherever it runs
and whatever runs beside it, and a crash ends no other one.
"""

from __future__ import annotations

import itertools
import os
import pickle
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from pathlib import Path

from tissue_sim.errors import UserError
from tissue_sim.parent_exit import exit_with_parent

CONNECT = 10.0  # s that a scheduler may take to answer
TRIES = 3  # more, of a calculation that failed on the cluster through no fault of its own
AHEAD = 256  # items that the cluster has at a time: enough for hundreds of workers without flooding the scheduler
_ASKED, _ANSWERED = "asked", "answered"  # files that a calculation's process reads and writes


def spread[Item, Result](
    job: Callable[[Item], Result], items: Iterable[Item], *, jobs: int = 1, scheduler: str | None = None
) -> Iterator[tuple[int, Result | UserError]]:
    """Yield the results of a job for every item, with the item's index, in the order in which they are ready.

    Where there is no result, a UserError that says why takes its place. Job and items are pickled, items one after the
    other as there is room for them.

    Parameters
    ----------
    job : Callable[[Item], Result]
        A module's function, called with an item.
    items : Iterable[Item]
        The items.
    jobs : int, optional
        Number of processes at a time on this machine.
    scheduler : str | None, optional
        Address of a Dask scheduler whose workers do the work instead.

    Yields
    ------
    Iterator[tuple[int, Result | UserError]]
        Index and result.

    Raises
    ------
    UserError
        Where the scheduler doesn't answer, or `distributed` is missing.
    """
    if scheduler is not None:
        yield from on_cluster(_in_process, ((job, item) for item in items), scheduler)
        return
    stopped = threading.Event()
    following = enumerate(items)
    running: dict[Future[Result | UserError], int] = {}
    with ThreadPoolExecutor(jobs) as threads:
        try:
            while True:
                for number, item in itertools.islice(following, jobs - len(running)):
                    running[threads.submit(_in_process, (job, item), stopped)] = number
                if not running:
                    return
                done, _ = wait(running, 0.2, FIRST_COMPLETED)  # in turns, so that an interrupt comes through
                for future in done:
                    yield running.pop(future), future.result()
        finally:
            stopped.set()


def on_cluster[Item, Result](
    job: Callable[[Item], Result], items: Iterable[Item], scheduler: str
) -> Iterator[tuple[int, Result | UserError]]:
    """Yield the results of a job for every item, computed in the processes of a Dask cluster's workers.

    Parameters
    ----------
    job : Callable[[Item], Result]
        A module's function, called with an item.
    items : Iterable[Item]
        The items.
    scheduler : str
        Address of the Dask scheduler.

    Yields
    ------
    Iterator[tuple[int, Result | UserError]]
        Index and result.

    Raises
    ------
    UserError
        Where the scheduler doesn't answer, or `distributed` is missing.
    """
    try:
        import distributed
    except ModuleNotFoundError:
        raise UserError("--scheduler needs distributed: pip install 'tissue_sim[cluster]'") from None
    try:
        client = distributed.Client(scheduler, timeout=CONNECT, set_as_default=False)
    except (OSError, ValueError, TimeoutError):
        raise UserError(f"no Dask scheduler answers at {scheduler}; start one with 'dask scheduler'") from None
    following = enumerate(items)
    number: dict[object, int] = {}  # by the key of a future

    def submitted(count: int) -> Iterator[distributed.Future]:
        for index, item in itertools.islice(following, count):
            # Not pure: an item that is requested again is computed again, whatever the cluster remembers.
            future = client.submit(job, item, pure=False, retries=TRIES)
            number[future.key] = index
            yield future

    with client:
        ready = distributed.as_completed(list(submitted(AHEAD)), loop=client.loop)
        for future in ready:
            try:
                result = future.result()
            except UserError as error:
                result = error
            except distributed.KilledWorker:
                result = UserError("its workers were lost one after the other; it may need more memory")
            except Exception as error:  # of a worker that lacks a package, say: whatever it is, the others go on
                result = UserError(f"{type(error).__name__} on the cluster: {error}")
            yield number.pop(future.key), result
            for more in submitted(1):
                ready.add(more)


def _in_process[Item, Result](
    work: tuple[Callable[[Item], Result], Item], stopped: threading.Event | None = None
) -> Result | UserError:
    """Run job(item) in a new process; return its result, or a UserError.

    The process isn't multiprocessing's: Dask's workers are daemons, for which multiprocessing allows no children.
    """
    if stopped is not None and stopped.is_set():
        return UserError("stopped")
    with tempfile.TemporaryDirectory(prefix="tissue_sim-") as folder:
        (Path(folder) / _ASKED).write_bytes(pickle.dumps(work))
        command = [sys.executable, "-m", "tissue_sim.calibration.cohort", folder]
        environment = os.environ | {"OPENBLAS_NUM_THREADS": "1"}
        # In a group of its own, which Ctrl-C in a terminal doesn't reach: it would end as if its work had failed.
        with subprocess.Popen(
            command, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, process_group=0
        ) as process:
            errors = _errors_of(process, stopped)
        answer = Path(folder) / _ANSWERED
        if process.returncode == 0 and answer.is_file():
            return pickle.loads(answer.read_bytes())
    if process.returncode < 0:
        name = signal.Signals(-process.returncode).name
        return UserError(f"its process was ended by {name}; it may need more memory")
    return UserError(f"its process failed: {errors.splitlines()[-1] if errors else process.returncode}")


def _errors_of(process: subprocess.Popen[bytes], stopped: threading.Event | None) -> str:
    """Return what a process wrote to its standard error until it ended or was killed."""
    while True:
        try:
            return process.communicate(timeout=0.2)[1].decode(errors="replace").strip()
        except subprocess.TimeoutExpired:
            if stopped is not None and stopped.is_set():
                process.kill()


def _answer(folder: Path) -> None:
    """Run a calculation in its own process, and write the result."""
    exit_with_parent()
    job, item = pickle.loads((folder / _ASKED).read_bytes())
    try:
        found = job(item)
    except UserError as error:
        found = error
    part = folder / f"{_ANSWERED}.part"
    part.write_bytes(pickle.dumps(found))
    part.replace(folder / _ANSWERED)


if __name__ == "__main__":
    _answer(Path(sys.argv[1]))
