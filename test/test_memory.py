"""Memory below Python."""

import subprocess
import sys

# In a process of its own: one that has run other tests has freed room to begin with.
FREED = """
import os
from tissue_sim.memory import give_back
from tissue_sim.ros.probes.soak_monitor import resident
before = resident(os.getpid())[0]
held = [bytearray(20_000) for _ in range(3_000)]
most = resident(os.getpid())[0]
kept = held[::100]
del held
give_back()
print(most - before, resident(os.getpid())[0] - before, len(kept))
"""


def test_what_was_freed_in_small_pieces_is_given_back():
    """All but one of every hundred, so that the end of the heap can't simply move down."""
    run = subprocess.run([sys.executable, "-c", FREED], capture_output=True, text=True, check=True)
    most, left, kept = map(float, run.stdout.split())
    assert most > 40.0, "MB"
    assert left < 0.25 * most
    assert kept == 30
