"""The finite-element body settles its loads in a process of its own, while the fit goes on."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from threading import Event, Thread
from typing import NamedTuple

import numpy as np

from tissue_sim.array_types import Floats
from tissue_sim.calibration.cases import Cases
from tissue_sim.calibration.checkpoint import Arrays, Checkpoint
from tissue_sim.calibration.fe_mesh import Grading
from tissue_sim.calibration.fem import Body, Settled
from tissue_sim.calibration.judge import Answer
from tissue_sim.calibration.remote import Remote
from tissue_sim.organ.organ import Organ


class Task(NamedTuple):
    """A set of cases, and the mesh on which they are settled.

    linear (c, n_surface, 3) m: what the reference's mesh gives by linear elasticity, where a coarser one settles
    the cases. The difference between the two meshes by linear elasticity is then added to what it comes to, which
    takes away most of its error.
    """

    cases: Cases
    grading: Grading | None = None
    linear: Floats | None = None


class Reference:
    """Settles sets of cases, one set after another; a set that is whole is kept in the checkpoint.

    Not case by case: what a case comes to depends, to rounding, on those that settle in step with it.
    """

    def __init__(self, organ: Organ, checkpoint: Checkpoint, tasks: dict[str, Task]) -> None:
        self._organ, self._checkpoint, self._tasks = organ, checkpoint, tasks
        self._answers: dict[str, Arrays] = {}
        self._settled = dict.fromkeys(tasks, 0)
        self._ready = {name: Event() for name in tasks}
        self._remote: Remote | None = None
        self._stopped = False
        self._failure: BaseException | None = None
        self._thread = Thread(target=self._work, daemon=True, name="finite elements")

    def begin(self) -> None:
        """Start to work."""
        self._thread.start()

    def stop(self) -> None:
        """End what is under way, and begin nothing more."""
        self._stopped = True
        if self._remote is not None:
            self._remote.close()

    def answer(self, name: str, done: Callable[..., None]) -> Answer:
        """Answers to a set of cases, as soon as they are there; `done` is called for each. Raises what went wrong."""
        told = 0
        while True:
            ready = self._ready[name].wait(0.2)  # in turns, so that an interrupt comes through
            if ready and self._failure is not None:
                raise self._failure
            for _ in range(told, len(self._tasks[name].cases) if ready else self._settled[name]):
                told += 1
                done()
            if ready:
                return Answer(**self._answers[name])

    def _work(self) -> None:
        try:
            for name, task in self._tasks.items():
                if self._stopped:
                    return
                self._answers[name] = self._checkpoint.remember(name, partial(self._settle, name, task))
                self._ready[name].set()
        except BaseException as failure:  # handed to whoever waits
            self._failure = failure
            for event in self._ready.values():
                event.set()

    def _settle(self, name: str, task: Task) -> Arrays:
        force = task.cases.force
        count = len(force)
        found = {"displacement": np.zeros_like(force), "volume": np.zeros(count), "converged": np.zeros(count)}
        if not count:
            return found
        remote = self._remote = Remote(Settler, self._organ, task.grading)
        try:
            remote.ask("begin", force)
            remote.answer()
            for case in range(count):
                remote.ask("following")
                settled: Settled = remote.answer()
                found["displacement"][case] = settled.displacement
                found["volume"][case] = settled.volume_change
                found["converged"][case] = float(settled.converged)
                self._settled[name] = case + 1
            if task.linear is not None:
                remote.ask("linear", force)
                found["displacement"] += task.linear - remote.answer()
        finally:
            remote.close()
        return found


class Settler:
    """A finite-element body that settles cases one after another."""

    def __init__(self, organ: Organ, grading: Grading | None) -> None:
        self._body = Body(organ, grading=grading)
        self._settled: Iterator[Settled] = iter(())

    def begin(self, force: Floats) -> None:
        """Take on cases (c, n_surface, 3) N."""
        self._settled = self._body.settle_many(force)

    def following(self) -> Settled:
        """The next case's rest."""
        return next(self._settled)

    def linear(self, force: Floats) -> Floats:
        """Linear displacements (c, n_surface, 3) m."""
        return self._body.settle_linear(force)
