"""The interface of what is compared: settle under a load, and take one update after another."""

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

TOLERANCE = 1e-3  # of its displacement, by which a settled engine's may still change from one look to the next
LOOK = 0.1  # simulated s between two looks


class Load(NamedTuple):
    """A load on a surface of n points, and where the reference is then."""

    force: Floats  # (n, 3) N
    reached: Floats  # (n, 3) m, for an engine that is moved instead of pushed

    @property
    def nodes(self) -> NDArray[np.int64]:
        """The loaded nodes (k,)."""
        return np.flatnonzero(np.any(self.force != 0.0, axis=1)).astype(np.int64)


class Answer(NamedTuple):
    """What an engine settles to."""

    displacement: Floats  # (n, 3) m of the surface
    seconds: float  # of the processor until then
    settled: bool


class Engine(Protocol):
    """A solver of one organ. It is made once, whatever that costs; then it answers one load after the other."""

    organ: Organ  # whose surface it moves
    update: float  # simulated s that an update stands for

    def settle(self, load: Load) -> Answer:
        """Where the surface comes to rest under a load, from the rest shape."""
        ...

    def burst(self, load: Load) -> Burst:
        """Times of updates under a load."""
        ...


def settle_by_steps(
    step: Callable[[], float],
    surface: Callable[[], Floats],
    tick: float,
    longest: float,
    tolerance: float = TOLERANCE,
) -> Answer:
    """Step an engine until its surface stands still.

    step: does a step of `tick` s and returns the processor's seconds for it; surface: displacements (n, 3) m now;
    longest: simulated s after which it counts as not settled, as it does when a value is not finite.
    tolerance: how much its displacement may change in 0.1 s, relative L2.
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
    """The processor's seconds in this thread for a piece of work."""
    start = time.thread_time()
    work()
    return time.thread_time() - start
