"""How long a fresh process takes to its first tick."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

import tissue_sim
from tissue_sim.errors import UserError

_CODE = """
import sys
sys.path.insert(0, sys.argv[1])
from tissue_sim.model.simulation import Simulation
from tissue_sim.organ.organ import Organ
simulation = Simulation(Organ.load(sys.argv[2]))
simulation.apply_force([0], [[0.0, 0.0, -1e-3]])
simulation.step()
"""


class Start(NamedTuple):
    """Seconds of a new process until the end of its first tick: of the clock on the wall, and of the processor."""

    wall: float
    processor: float


def first_start(organ: Path, *, compiled: bool) -> Start:
    """Start a Python process that loads an organ and does one tick under a load.

    compiled: with the kernels that are kept on disk, else with an empty folder for them.
    """
    words = [sys.executable, "-c", _CODE, str(Path(tissue_sim.__file__).parents[1]), str(organ.absolute())]
    with tempfile.TemporaryDirectory(prefix="tissue_sim-") as empty:
        environment = os.environ if compiled else os.environ | {"NUMBA_CACHE_DIR": empty}
        start, before = time.perf_counter(), _processor_of_children()
        done = subprocess.run(words, env=environment, capture_output=True, text=True)
        took = Start(time.perf_counter() - start, _processor_of_children() - before)
    if done.returncode:
        raise UserError(f"a fresh process did not reach its first tick: {(done.stderr.splitlines() or ['killed'])[-1]}")
    return took


def _processor_of_children() -> float:
    """Processor seconds of all children that have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime
