"""Memory below Python."""

import mmap
import resource
import subprocess
import sys
from typing import NamedTuple

import numpy as np

from tissue_sim.memory import provide

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


class Pair(NamedTuple):
    numbers: np.ndarray
    others: tuple[np.ndarray, float]


def faults_of_writing(pair):
    """Page faults of this thread while arrays are written to."""
    before = resource.getrusage(resource.RUSAGE_THREAD).ru_minflt
    pair.numbers[:] = 1.0
    pair.others[0][:] = 1
    return resource.getrusage(resource.RUSAGE_THREAD).ru_minflt - before


def test_provided_memory_is_there_and_has_its_values():
    def untouched(shape, kind):
        memory = mmap.mmap(-1, 300 * mmap.PAGESIZE)
        memory.madvise(mmap.MADV_NOHUGEPAGE)
        return np.frombuffer(memory, kind).reshape(shape)

    def made():
        return Pair(untouched(-1, np.float64), (untouched((10, -1), np.int64), 3.0))

    assert faults_of_writing(made()) > 500
    pair = made()
    pair.numbers[:5] = np.arange(5.0)
    provide(pair)
    np.testing.assert_array_equal(pair.numbers[:6], [0.0, 1.0, 2.0, 3.0, 4.0, 0.0])
    assert faults_of_writing(pair) < 30


def test_memory_that_cannot_be_written_to_is_left_alone():
    fixed = np.zeros(10)
    fixed.flags.writeable = False
    provide((fixed, np.zeros(0), np.zeros((4, 4))[:, ::2], None))
