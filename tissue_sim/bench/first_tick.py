"""Process `python -m tissue_sim.bench.first_tick BEGAN ORGAN`, timed up to its first tick.

BEGAN is when it was started, s of the monotonic clock. It prints JSON in seconds: the parts, one after the other,
without what was compiled in them; that, by the module of the kernel; the total by wall clock and by processor time.
"""

from __future__ import annotations

import time

ENTERED = time.monotonic()  # before anything else is imported

import json  # noqa: E402
import sys  # noqa: E402
from collections.abc import Iterable  # noqa: E402
from itertools import pairwise  # noqa: E402

from numba.core import event  # noqa: E402

from tissue_sim.model.simulation import Simulation  # noqa: E402
from tissue_sim.organ.organ import Organ  # noqa: E402
from tissue_sim.unexpected_errors import catch_all  # noqa: E402


def main(began: str, organ_file: str) -> None:
    """Do one tick under a load."""
    marks = [float(began), ENTERED, time.monotonic()]
    organ = Organ.load(organ_file)
    marks.append(time.monotonic())
    with event.install_recorder("numba:compile") as assembling:
        simulation = Simulation(organ)
    marks.append(time.monotonic())
    with event.install_recorder("numba:compile") as ticking:
        simulation.apply_force([0], [[0.0, 0.0, -1e-3]])
        simulation.step()
    marks.append(time.monotonic())
    interpreter, imports, loading, assembled, ticked = (b - a for a, b in pairwise(marks))
    kernels = by_kernel(assembling.buffer), by_kernel(ticking.buffer)
    compiled: dict[str, float] = {}
    for name, seconds in (*kernels[0], *kernels[1]):
        compiled[name] = compiled.get(name, 0.0) + seconds
    parts = {
        "interpreter": interpreter,
        "imports": imports,
        "organ": loading,
        "assembling": assembled - sum(seconds for _, seconds in kernels[0]),
        "compiling": sum(compiled.values()),
        "first tick": ticked - sum(seconds for _, seconds in kernels[1]),
    }
    found = {"parts": parts, "compiled": compiled, "wall": marks[-1] - marks[0], "processor": time.process_time()}
    print(json.dumps(found))


def by_kernel(events: Iterable[tuple[float, event.Event]]) -> list[tuple[str, float]]:
    """Return modules of kernels in the order of compilation, and the s that each took without callees.

    events: times in s and Numba's events of beginning and ending to compile, which nest.
    """
    found, begun, within = [], [], []
    for clock, what in events:
        if what.is_start:
            begun.append(clock)
            within.append(0.0)
            continue
        took, callees = clock - begun.pop(), within.pop()
        if within:
            within[-1] += took
        module = what.data["dispatcher"].py_func.__module__
        found.append((module.removeprefix("tissue_sim."), took - callees))
    return found


if __name__ == "__main__":
    catch_all("first_tick")
    main(*sys.argv[1:3])
