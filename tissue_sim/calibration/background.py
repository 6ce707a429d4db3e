"""The finite-element body settles its loads in a process of its own, while the fit goes on."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import CancelledError, ThreadPoolExecutor, wait
from functools import partial
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
    """Settles sets of cases from now on, one set after another; a set that is whole is kept in the checkpoint.

    Not case by case: what a case comes to depends, to rounding, on those that settle in step with it.
    """

    def __init__(self, organ: Organ, checkpoint: Checkpoint, tasks: dict[str, Task]) -> None:
        self._organ = organ
        self._settled = dict.fromkeys(tasks, 0)
        self._remote: Remote | None = None
        self._stopped = False
        self._thread = ThreadPoolExecutor(1, "finite elements")
        self._answers = {
            name: self._thread.submit(checkpoint.remember, name, partial(self._settle, name, task))
            for name, task in tasks.items()
        }

    def stop(self) -> None:
        """End what is under way, and begin nothing more."""
        self._stopped = True
        if self._remote is not None:
            self._remote.close()
        self._thread.shutdown(cancel_futures=True)

    def answer(self, name: str, done: Callable[..., None]) -> Answer:
        """Answers to a set of cases, as soon as they are there; `done` is called for each. Raises what went wrong."""
        told, answer = 0, self._answers[name]
        while not answer.done():
            wait([answer], 0.2)  # in turns, so that an interrupt comes through
            for _ in range(told, self._settled[name]):
                told += 1
                done()
        found = Answer(**answer.result())
        for _ in range(told, len(found.converged)):
            done()
        return found

    def _settle(self, name: str, task: Task) -> Arrays:
        force = task.cases.force
        count = len(force)
        found = {"displacement": np.zeros_like(force), "volume": np.zeros(count), "converged": np.zeros(count)}
        if not count:
            return found
        remote = self._remote = Remote(Settler, self._organ, task.grading)
        try:
            if self._stopped:
                raise CancelledError
            remote.call("begin", force)
            for case in range(count):
                settled: Settled = remote.call("following")
                found["displacement"][case] = settled.displacement
                found["volume"][case] = settled.volume_change
                found["converged"][case] = float(settled.converged)
                self._settled[name] = case + 1
            if task.linear is not None:
                found["displacement"] += task.linear - remote.call("linear", force)
        finally:
            remote.close()
        return found


class Settler:
    """A finite-element body that settles cases one after another."""

    def __init__(self, organ: Organ, grading: Grading | None) -> None:
        self._organ, self._grading = organ, grading

    def begin(self, force: Floats) -> None:
        """Make the body, and take on cases (c, n_surface, 3) N. Raises UserError as the body does."""
        self._body = Body(self._organ, grading=self._grading)
        self._settled = self._body.settle_many(force)

    def following(self) -> Settled:
        """The next case's rest."""
        return next(self._settled)

    def linear(self, force: Floats) -> Floats:
        """Linear displacements (c, n_surface, 3) m."""
        return self._body.settle_linear(force)
