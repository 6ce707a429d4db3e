"""Program that makes cuts for a node: requests come on its standard input, answers go to its standard output.

It ends with its input, which closes when the node ends, however that ends.
"""

from __future__ import annotations

import os
import pickle
import sys
import traceback
from contextlib import suppress
from typing import BinaryIO

from tissue_sim.errors import UserError
from tissue_sim.ros.node.services.simulation_parts import Parts, Prepared, SomeCut, parts_of, simulation_of

NICE = 10  # ticks, poses and their answers go first
MADE, REFUSED, FAILED = "made", "refused", "failed"


def serve(requests: BinaryIO, answers: BinaryIO) -> None:
    """Answer requests until they end.

    requests: pickles of the parts of a simulation and the cut (a SomeCut); answers: takes pickles of MADE with the cut
    simulation's parts, surface and file, or REFUSED or FAILED with a text.
    """
    while True:
        try:
            request = pickle.load(requests)
        except EOFError:
            return
        pickle.dump(_answer(*request), answers, protocol=pickle.HIGHEST_PROTOCOL)
        answers.flush()


def _answer(parts: Parts, cut: SomeCut) -> tuple[str, object]:
    """Return what came of a cut of a simulation."""
    try:
        before = simulation_of(parts)
        made = Prepared.of(before.prepared_sheet(*cut) if len(cut) == 1 else before.prepared_cut(*cut))
        return MADE, (parts_of(made.simulation), made.surface, made.file)
    except UserError as error:
        return REFUSED, str(error)
    except Exception:
        return FAILED, traceback.format_exc()


if __name__ == "__main__":
    os.nice(NICE)
    answering = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # what a library prints is not an answer
    with suppress(BrokenPipeError):  # the node has ended
        serve(sys.stdin.buffer, answering)
