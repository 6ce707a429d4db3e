"""Reference answers of the finite-element body, computed in a separate process while the fit goes on."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor, wait

import numpy as np

from tissue_sim.array_types import Floats
from tissue_sim.calibration.cases import Cases
from tissue_sim.calibration.checkpoint import Arrays, Checkpoint
from tissue_sim.calibration.dynamics import release
from tissue_sim.calibration.evaluation import RELEASE_STEP, RELEASE_TIME, Answer
from tissue_sim.calibration.fem import Body, Settled
from tissue_sim.calibration.remote import Remote
from tissue_sim.organ.organ import Organ

Poke = tuple[Floats, int]  # forces (n_surface, 3) N that a release begins with, and the node that is followed


class Reference:
    """Computation of the reference in the background: it settles the cases, then releases one of them.

    Only complete results are kept in the checkpoint, not single cases: the result of a case depends, to rounding, on
    those that settle in step with it.

    Parameters
    ----------
    poke : Callable[[Answer], Poke]
        Chooses the load that is released from the answers.
    rate : float, 1/s
        Damping over mass.
    organ : Organ
        The organ.
    checkpoint : Checkpoint
        Keeps the intermediate results.
    cases : Cases
        The load cases.
    """

    def __init__(
        self, organ: Organ, checkpoint: Checkpoint, cases: Cases, poke: Callable[[Answer], Poke], rate: float
    ) -> None:
        self._organ, self._cases, self._poke, self._rate = organ, cases, poke, rate
        self._settled = 0
        self._remote: Remote | None = None
        self._stopped = False
        self._thread = ThreadPoolExecutor(1, "finite elements")

        def kept(name: str, make: Callable[[], Arrays]) -> Future[Arrays]:
            return self._thread.submit(checkpoint.remember, name, make)

        self._answer, self._motion = kept("held-out", self._settle), kept("release", self._release)

    def stop(self) -> None:
        """End what is running, and start nothing more."""
        self._stopped = True
        if self._remote is not None:
            self._remote.close()
        self._thread.shutdown(cancel_futures=True)

    def answer(self, done: Callable[..., None]) -> Answer:
        """Return the answers to the cases as soon as they are complete.

        Parameters
        ----------
        done : Callable[..., None]
            Called for each case.

        Returns
        -------
        Answer
            The answers.
        """
        told = 0
        while not self._answer.done():
            wait([self._answer], 0.2)  # in turns, so that an interrupt comes through
            for _ in range(told, self._settled):
                told += 1
                done()
        found = Answer(**self._answer.result())
        for _ in range(told, len(found.converged)):
            done()
        return found

    def motion(self) -> Arrays:
        """Return the motion of the node after the release.

        Returns
        -------
        Arrays
            Times (t,) s and displacements (t, 3) m, by the names `time` and `displacement`.
        """
        while not self._motion.done():
            wait([self._motion], 0.2)
        return self._motion.result()

    def _body(self) -> Remote:
        if self._remote is None and not self._stopped:
            self._remote = Remote(_Bodies, self._organ)
        if self._stopped or self._remote is None:
            if self._remote is not None:  # it may have started after `stop` had looked
                self._remote.close()
            raise CancelledError
        return self._remote

    def _settle(self) -> Arrays:
        force = self._cases.force
        count = len(force)
        found = {name: np.zeros(count) for name in ("volume", "converged", "least")}
        found["displacement"] = np.zeros_like(force)
        remote = self._body()
        remote.call("begin", force)
        for case in range(count):
            settled: Settled = remote.call("following")
            found["displacement"][case] = settled.displacement
            found["volume"][case] = settled.volume_change
            found["converged"][case] = float(settled.converged)
            found["least"][case] = settled.least_det
            self._settled = case + 1
        return found

    def _release(self) -> Arrays:
        force, node = self._poke(Answer(**self._answer.result()))
        made: Arrays = self._body().call("release", force, node, self._rate)
        return made


class _Bodies:
    """Finite elements in a separate process; the methods raise UserError as Body does."""

    def __init__(self, organ: Organ) -> None:
        self._organ = organ
        self._body: Body | None = None

    def begin(self, force: Floats) -> None:
        """Start settling cases (c, n_surface, 3) N."""
        self._settled = self._made().settle_many(force)

    def following(self) -> Settled:
        """Return the next case's equilibrium."""
        return next(self._settled)

    def release(self, force: Floats, node: int, rate: float) -> Arrays:
        """Return the motion of a node after the release from equilibrium under forces (n_surface, 3) N."""
        motion = release(self._made(), force, RELEASE_TIME, RELEASE_STEP, rate, [node])
        return {"time": motion.time, "displacement": motion.displacement[:, 0]}

    def _made(self) -> Body:
        if self._body is None:
            self._body = Body(self._organ)
        return self._body
