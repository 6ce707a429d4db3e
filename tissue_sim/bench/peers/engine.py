"""Interface of the compared engines: settle under a load, and do one update after another."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from tissue_sim.array_types import Floats
from tissue_sim.bench.timing import Burst
from tissue_sim.organ.organ import Organ

TOLERANCE = 1e-3  # relative change of the displacement between checks, below which an engine has settled
LOOK = 0.1  # simulated s between two checks


class Load(NamedTuple):
    """Load on a surface of n points, and the reference's displacements under it."""

    force: Floats  # (n, 3) N
    reached: Floats  # (n, 3) m, for an engine that is moved instead of pushed

    @property
    def nodes(self) -> NDArray[np.int64]:
        """Loaded nodes (k,)."""
        return np.flatnonzero(np.any(self.force != 0.0, axis=1)).astype(np.int64)


class Answer(NamedTuple):
    """Equilibrium of an engine."""

    displacement: Floats  # (n, 3) m of the surface
    seconds: float  # of the processor until then
    settled: bool


class Engine(Protocol):
    """Solver of one organ, which is made once, whatever that takes, and then answers one load after the other."""

    organ: Organ  # whose surface it moves
    update: float  # simulated s that an update stands for

    def settle(self, load: Load) -> Answer:
        """Return the equilibrium of the surface under a load, from the rest shape."""
        ...

    def burst(self, load: Load) -> Burst:
        """Return a function that times updates under a load."""
        ...


def settle_by_steps(
    step: Callable[[], float],
    surface: Callable[[], Floats],
    tick: float,
    longest: float,
    tolerance: float = TOLERANCE,
) -> Answer:
    """Step an engine until its surface is at rest.

    step: does a step and returns its processor time, s; surface: returns the present displacements, shape (n, 3), m;
    tick: time step, s; longest: simulated time after which it counts as not settled, as it does when a value is not
    finite, s; tolerance: largest relative change (L2) of the displacement in 0.1 s. Returns the equilibrium.
    """
    stride = max(1, round(LOOK / tick))
    before = np.zeros_like(surface())
    seconds = 0.0
    for _ in range(max(1, math.ceil(longest / (stride * tick)))):
        for _ in range(stride):
            seconds += step()
        now = surface()
        if not np.all(np.isfinite(now)):
            return Answer(before, seconds, False)
        if np.linalg.norm(now - before) <= tolerance * np.linalg.norm(now):
            return Answer(now, seconds, True)
        before = now.copy()
    return Answer(before, seconds, False)


def timed(work: Callable[[], object]) -> float:
    """Return the processor time of this thread for a piece of work, s."""
    start = time.thread_time()
    work()
    return time.thread_time() - start
