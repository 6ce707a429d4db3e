"""Reference answers of the finite-element body, computed in a separate process while the fit goes on.

Once the fit has nothing left to do but to wait, its process solves loads, too, so that both cores are used to the end.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor, wait
from threading import Condition

import numpy as np

from tissue_sim.array_types import Floats
from tissue_sim.calibration.cases import Cases
from tissue_sim.calibration.checkpoint import Arrays, Checkpoint
from tissue_sim.calibration.dynamics import Steps, lowest_frequencies, release
from tissue_sim.calibration.evaluation import RELEASE_STEP, RELEASE_TIME, Answer
from tissue_sim.calibration.fem import Body, Settled
from tissue_sim.calibration.inertia import MODES
from tissue_sim.calibration.remote import Remote
from tissue_sim.organ.organ import Organ

Poke = tuple[Floats, int]  # forces (n_surface, 3) N that a release begins with, and the node that is followed
GROUP = 10  # cases that settle together, by whichever process is free


class Reference:
    """Finite-element body of an organ in a separate process, which works on its tasks one after the other.

    It starts with the linear answers to the held-out loads and the lowest frequencies; `settle` adds further tasks.
    Only complete results are kept in the checkpoint, not single cases: the result of a case depends, to rounding, on
    those that settle in step with it. These are a fixed group, so that the result is the same bit for bit whichever
    process settles them.

    Parameters
    ----------
    organ : Organ
        The organ.
    checkpoint : Checkpoint
        Keeps the intermediate results.
    held_out : Floats, shape (c, n_surface, 3), N
        Loads whose linear answers are needed.
    """

    def __init__(self, organ: Organ, checkpoint: Checkpoint, held_out: Floats) -> None:
        self._organ, self._checkpoint = organ, checkpoint
        self._groups: deque[slice] = deque()
        self._remote: Remote | None = None
        self._stopped = False
        self._changed = Condition()
        self._thread = ThreadPoolExecutor(1, "finite elements")
        self._linear = self._kept("linear-held-out", lambda: self._body().call("linear", held_out))

    def settle(self, cases: Cases, poke: Callable[[Answer], Poke], rate: float) -> None:
        """Start settling cases, and then the release of one of them.

        Parameters
        ----------
        cases : Cases
            The load cases.
        poke : Callable[[Answer], Poke]
            Chooses the load that is released from the answers.
        rate : float, 1/s
            Damping over mass.
        """
        self._cases, self._poke, self._rate = cases, poke, rate
        self._found = {name: np.zeros(len(cases)) for name in ("volume", "converged", "least")}
        self._found["displacement"] = np.zeros_like(cases.force)
        self._settled = 0
        self._answer, self._motion = self._kept("held-out", self._settle), self._kept("release", self._release)

    def stop(self) -> None:
        """End what is running, and start nothing more."""
        with self._changed:
            self._stopped = True
            self._changed.notify_all()
        if self._remote is not None:
            self._remote.close()
        self._thread.shutdown(cancel_futures=True)

    def linear(self) -> Arrays:
        """Return the linear answers to the held-out loads as soon as they are complete.

        Returns
        -------
        Arrays
            Displacements (c, n_surface, 3) m and lowest frequencies (m,) Hz, by the names `held_out` and `frequencies`.
        """
        return _result_of(self._linear)

    def answer(self, body: Body, done: Callable[..., None]) -> Answer:
        """Return the answers to the cases as soon as they are complete.

        Parameters
        ----------
        body : Body
            The same body in this process, which settles the remaining groups while the other process settles its own.
        done : Callable[..., None]
            Called for each case.
        """
        reported = 0
        while not self._answer.done():
            group = self._next(last=True)
            if group is None:
                wait([self._answer], 0.2)  # divided, so that an interrupt comes through
            else:
                for case, settled in enumerate(body.settle_many(self._cases.force[group]), group.start):
                    self._take(case, settled)
                    reported = _report(done, reported, self._settled)
            reported = _report(done, reported, self._settled)
        found = Answer(**self._answer.result())
        _report(done, reported, len(found.converged))
        return found

    def motion(self) -> Arrays:
        """Return the motion of the node after the release.

        Returns
        -------
        Arrays
            Times (t,) s and displacements (t, 3) m, by the names `time` and `displacement`.
        """
        return _result_of(self._motion)

    def _kept(self, name: str, make: Callable[[], Arrays]) -> Future[Arrays]:
        return self._thread.submit(self._checkpoint.remember, name, make)

    def _body(self) -> Remote:
        if self._remote is None and not self._stopped:
            self._remote = Remote(_Bodies, self._organ)
        if self._stopped or self._remote is None:
            if self._remote is not None:  # it may have started after `stop` had looked
                self._remote.close()
            raise CancelledError
        return self._remote

    def _settle(self) -> Arrays:
        count = len(self._cases)
        with self._changed:
            self._groups.extend(slice(first, min(first + GROUP, count)) for first in range(0, count, GROUP))
        while (group := self._next(last=False)) is not None:
            remote = self._body()
            remote.call("begin", self._cases.force[group])
            for case in range(group.start, group.stop):
                self._take(case, remote.call("following"))
        with self._changed:
            self._changed.wait_for(lambda: self._stopped or self._settled == count)
            if self._stopped:
                raise CancelledError
        return self._found

    def _next(self, *, last: bool) -> slice | None:
        """Return the first or the last group that neither process has started; None where none is left."""
        with self._changed:
            if not self._groups or self._stopped:
                return None
            return self._groups.pop() if last else self._groups.popleft()

    def _take(self, case: int, settled: Settled) -> None:
        """Store the equilibrium of a case."""
        with self._changed:
            self._found["displacement"][case] = settled.displacement
            self._found["volume"][case] = settled.volume_change
            self._found["converged"][case] = float(settled.converged)
            self._found["least"][case] = settled.least_det
            self._settled += 1
            self._changed.notify_all()

    def _release(self) -> Arrays:
        force, node = self._poke(Answer(**self._answer.result()))
        made: Arrays = self._body().call("release", force, node, self._rate)
        return made


def _result_of(future: Future[Arrays]) -> Arrays:
    """Return the result of a future; the wait is divided, so that an interrupt comes through."""
    while not future.done():
        wait([future], 0.2)
    return future.result()


def _report(done: Callable[..., None], reported: int, count: int) -> int:
    """Call `done` for those of `count` cases that it hasn't been called for; return count."""
    for _ in range(reported, count):
        done()
    return count


class _Bodies:
    """Finite elements in a separate process; the methods raise UserError as Body does."""

    def __init__(self, organ: Organ) -> None:
        self._organ = organ
        self._body: Body | None = None

    def linear(self, force: Floats) -> Arrays:
        """Return linear answers (c, n_surface, 3) m to loads (c, n_surface, 3) N, and the lowest frequencies, Hz."""
        body = self._made()
        return {"held_out": body.settle_linear(force), "frequencies": lowest_frequencies(body, MODES)}

    def begin(self, force: Floats) -> None:
        """Start settling cases (c, n_surface, 3) N."""
        self._settled = self._made().settle_many(force)

    def following(self) -> Settled:
        """Return the next case's equilibrium."""
        return next(self._settled)

    def release(self, force: Floats, node: int, rate: float) -> Arrays:
        """Return the motion of a node after the release from equilibrium under forces (n_surface, 3) N."""
        motion = release(self._made(), force, Steps(RELEASE_TIME, RELEASE_STEP), rate, [node])
        return {"time": motion.time, "displacement": motion.displacement[:, 0]}

    def _made(self) -> Body:
        if self._body is None:
            self._body = Body(self._organ)
        return self._body
