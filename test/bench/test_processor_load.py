"""Processor time of running processes."""

import os
import subprocess
import sys
import threading
import time

import pytest

from tissue_sim.bench.processor_load import processor_load_during, processor_seconds
from tissue_sim.errors import UserError


def burn(seconds):
    end = time.thread_time() + seconds
    while time.thread_time() < end:
        pass


def test_time_of_a_process_holds_threads_that_have_ended():
    before, mine = processor_seconds(os.getpid()), time.process_time()
    worker = threading.Thread(target=burn, args=(0.1,))
    worker.start()
    worker.join()
    spent = processor_seconds(os.getpid()) - before
    assert 0.1 - 1e-3 <= spent <= time.process_time() - mine + 1e-3  # clocks that are read one after the other


def test_busiest_thread_is_left_out_when_asked():
    process = os.getpid()
    assert 0.0 <= processor_seconds(process, busiest=False) < processor_seconds(process)


def test_fractions_are_those_of_the_wait():
    spent = {"working": 0.0, "idle": 0.0}

    def wait():
        time.sleep(0.05)
        spent["working"] = 0.025

    fractions = processor_load_during({name: lambda n=name: spent[n] for name in spent}, wait)
    assert 0.0 < fractions["working"] <= 50.0
    assert fractions["idle"] == 0.0


def test_process_that_has_ended_is_named():
    child = subprocess.Popen([sys.executable, "-c", ""])
    child.wait()
    with pytest.raises(UserError, match=str(child.pid)):
        processor_seconds(child.pid)
