"""Loop with the node's rate and load that does nothing else: what this machine allows at that moment."""

from __future__ import annotations

import numpy as np

from tissue_sim.array_types import Floats, Longs
from tissue_sim.bench.printing import Bound
from tissue_sim.jit import kernel
from tissue_sim.json_types import JsonObject
from tissue_sim.model.runtime.loop import now, sleep_until
from tissue_sim.ros.shared.priority import with_priority

RATE = 1000.0  # Hz, of ticks and poses
MOST_OF_BARE, POINTS_BEYOND = 2.0, 0.2  # bound on the fraction of late ticks, as a factor and in percentage points


def bare(seconds: float, busy: float, priority: int = 0) -> Floats:
    """Return how late the ticks of a loop at RATE are that only keeps the processor busy.

    busy: busy time of each tick, s; priority: real-time priority, 0 for none. Returns (ticks,) s.
    """
    late = np.zeros(round(seconds * RATE), dtype=np.int64)
    clock = np.zeros(4, dtype=np.int64)
    with_priority(lambda: bare_loop(round(1e9 / RATE), round(1e9 * busy), late, clock), priority)
    return np.multiply(1e-9, late, dtype=np.float64)


def late_percent(late: Floats) -> float:
    """Return the percentage of ticks that were late by more than a period, from their lateness (ticks,) s."""
    return 100.0 * float(np.mean(late > 1.0 / RATE))


def late_bound(name: str, percent: float, usual_percent: float) -> Bound:
    """Return the bound on a percentage of late ticks, relative to that of a bare loop, or of a quiet machine.

    percent: the percentage, %; usual_percent: that of the comparison, %.
    """
    return Bound(name, percent, MOST_OF_BARE * usual_percent + POINTS_BEYOND, "%")


def name_of(node: JsonObject) -> str:
    """Return what a node is called in a table, by its real-time priority."""
    priority = node["realtime_priority"]
    return f"priority {priority}" if priority else "no priority"


@kernel
def bare_loop(period: int, busy: int, late: Longs, clock: Longs) -> None:
    """Sleep to each deadline, `period` ns apart, and be busy for `busy` ns; late (n,) receives ns."""
    deadline = now(clock)
    for tick in range(len(late)):
        deadline += period
        sleep_until(deadline, clock)
        start = now(clock)
        late[tick] = start - deadline
        while now(clock) - start < busy:
            pass
