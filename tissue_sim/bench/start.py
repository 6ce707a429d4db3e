"""How long a fresh process takes to its first tick."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

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


def first_start(organ: Path, *, compiled: bool) -> float:
    """Seconds from the start of a Python process to the end of the first tick of an organ.

    compiled: with the kernels that are kept on disk, else with an empty folder for them.
    """
    words = [sys.executable, "-c", _CODE, str(Path(tissue_sim.__file__).parents[1]), str(organ.absolute())]
    with tempfile.TemporaryDirectory(prefix="tissue_sim-") as empty:
        environment = os.environ if compiled else os.environ | {"NUMBA_CACHE_DIR": empty}
        start = time.perf_counter()
        done = subprocess.run(words, env=environment, capture_output=True, text=True)
        seconds = time.perf_counter() - start
    if done.returncode:
        raise UserError(f"a fresh process did not reach its first tick: {(done.stderr.splitlines() or ['killed'])[-1]}")
    return seconds
