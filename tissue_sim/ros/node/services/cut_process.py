"""Cuts made in a process of their own, so that neither ticks nor answers wait for Python's lock or the libraries."""

from __future__ import annotations

import os
import pickle
import signal
import subprocess
import sys
import threading

from tissue_sim.errors import UserError
from tissue_sim.model.simulation import Simulation
from tissue_sim.ros.node.services.cut_program import MADE, REFUSED
from tissue_sim.ros.node.services.simulation_parts import Prepared, SomeCut, parts_of, simulation_of

# Of the numerical libraries, one of each: it must not take both cores.
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")

PATIENCE = 2.0  # s for the process to end by itself


class Ending(UserError):
    """Error: the node is ending, and with it the process that makes cuts."""

    def __init__(self) -> None:
        super().__init__("the node is ending, and makes no more cuts")


class CutProcess:
    """Process that makes cuts, one after the other; it is started before the first one, and again where it has ended.

    Methods may be called from any thread.
    """

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        self._starting, self._working = threading.Lock(), threading.Lock()
        self._closed = False

    def start(self) -> subprocess.Popen[bytes]:
        """Start the process where it doesn't run, and return it; it then needs a second or two until it works.

        Raises Ending after `close`.
        """
        with self._starting:
            if self._closed:
                raise Ending
            if self._process is None or self._process.poll() is not None:
                self._process = subprocess.Popen(
                    [sys.executable, "-m", "tissue_sim.ros.node.services.cut_program"],
                    stdin=subprocess.PIPE,
                    stdout=subprocess.PIPE,
                    env=os.environ | ONE_THREAD,
                    start_new_session=True,  # Ctrl-C in the terminal reaches only the node
                )
            return self._process

    def cut(self, before: Simulation, cut: SomeCut) -> Prepared:
        """Return what `Simulation.prepared_cut` or `prepared_sheet` does, and what goes with it.

        before: the simulation, which may be running; cut: a blade's edge, shape (m, 3), m, the direction in which it is
        moved, and how far, m (or a sheet). Raises UserError as `prepared_cut` does, and where the process has ended;
        Ending after `close`; RuntimeError where it fails.
        """
        with self._working:
            process = self.start()
            assert process.stdin is not None
            assert process.stdout is not None
            try:
                pickle.dump((parts_of(before), cut), process.stdin, pickle.HIGHEST_PROTOCOL)
                process.stdin.flush()
                kind, found = pickle.load(process.stdout)
            except (BrokenPipeError, EOFError, pickle.UnpicklingError):
                process.kill()  # half of an answer would be taken for the next one
                if self._closed:
                    raise Ending from None
                raise UserError(f"the process that makes cuts {_ended(process)}; call the service again") from None
        if kind == REFUSED:
            raise UserError(found)
        if kind != MADE:
            raise RuntimeError(f"the process that makes cuts failed: {found}")
        parts, surface, file = found
        return Prepared(simulation_of(parts | {"shapes": before.shapes}), surface, file)

    def close(self) -> None:
        """End the process, whatever it is doing, and start none any more."""
        with self._starting:
            self._closed = True
            if self._process is not None:
                self._process.terminate()


def _ended(process: subprocess.Popen[bytes]) -> str:
    """Return how a process has ended."""
    code = process.wait(PATIENCE)
    return f"was ended by {signal.Signals(-code).name}" if code < 0 else f"has ended with exit code {code}"
