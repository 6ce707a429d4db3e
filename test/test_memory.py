"""Memory below Python."""

import os

from tissue_sim.memory import give_back
from tissue_sim.ros.probes.soak_watch import resident


def test_what_was_freed_in_small_pieces_is_given_back():
    """All but one of every hundred, so that the end of the heap can't simply move down."""
    before = resident(os.getpid())[0]
    held = [bytearray(20_000) for _ in range(3_000)]
    most = resident(os.getpid())[0]
    kept = held[::100]
    del held
    give_back()
    left = resident(os.getpid())[0]
    assert most - before > 40.0, "MB"
    assert left - before < 0.25 * (most - before)
    assert len(kept) == 30
