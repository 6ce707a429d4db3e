"""Timing in turns, in one thread, of ticks alone."""

import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from helpers.patience import wait_for
from helpers.scenes import ball
from tissue_sim.bench.organs import patch_load
from tissue_sim.bench.timing import (
    LEAST_SAMPLES,
    Phase,
    Ticks,
    clock_cost,
    describe,
    in_one_thread,
    interleave,
    noise_burst,
    time_calls,
)
from tissue_sim.errors import UserError
from tissue_sim.model.simulation import Simulation
from tissue_sim.organ.organ import Organ


def test_describe_takes_median_and_percentile():
    timing = describe(np.arange(1.0, 102.0))
    assert timing == (51.0, 100.0, 101)


def test_everything_is_measured_in_turns_and_what_is_slow_less_often():
    order = []

    def taking(seconds, name):
        def burst(count):
            order.append(name)
            return np.full(count, seconds)

        return burst

    found = interleave(Phase({"fast": taking(1e-4, "fast"), "slow": taking(0.4, "slow")}, 1.0, "test"))
    assert found["fast"].median == 1e-4
    assert found["slow"].median == 0.4
    # Once to learn how long each takes, then by turns.
    assert order[:5] == ["fast", "slow", "fast", "slow", "fast"]
    assert found["slow"].samples == LEAST_SAMPLES
    assert found["fast"].samples > 1000
    assert max(k for k, name in enumerate(order) if name == "slow") > len(order) // 2, "spread over the run"


def test_time_is_that_of_the_work():
    sums = time_calls(lambda: sum(range(20_000)), 20)
    more = time_calls(lambda: sum(range(200_000)), 20)
    assert len(sums) == 20
    assert 4.0 < np.median(more) / np.median(sums) < 25.0
    assert np.median(noise_burst(5)) > 0.0
    assert clock_cost() > 0.0


def test_sleeping_takes_no_time():

    assert np.median(time_calls(lambda: time.sleep(0.01), 3)) < 0.01


def test_ticks_move_the_organ_and_are_all_that_is_done():
    simulation = Simulation(ball(2))
    ticks = Ticks(simulation, *patch_load(ball(2), 0.05))
    times = ticks(50)
    assert times.shape == (50,)
    assert np.median(times) > 0.0
    assert simulation.state.status.tick == 52
    assert np.abs(simulation.positions - simulation.model.rest).max() > 1e-5


def test_unloaded_ticks_are_asleep_and_cheaper():
    simulation = Simulation(ball(2))
    nothing = np.zeros(0, dtype=np.int64), np.zeros((0, 3))
    asleep = np.median(Ticks(simulation, *nothing)(200))
    assert simulation.asleep
    assert asleep < 0.5 * np.median(Ticks(simulation, *patch_load(ball(2), 0.05))(200))


def test_steady_bursts_begin_at_rest():
    simulation = Simulation(ball(2))
    ticks = Ticks(simulation, *patch_load(ball(2), 0.05), steady=True)
    ends = []
    for _ in range(2):
        ticks(30)
        ends.append(simulation.positions.copy())
    np.testing.assert_array_equal(ends[0], ends[1])


def test_guard_is_a_part_of_the_tick():
    load = patch_load(ball(3), 0.05)
    whole, guard = (np.median(Ticks(Simulation(ball(3)), *load, guard=only)(200)) for only in (False, True))
    assert 0.0 < guard < 0.5 * whole


def test_child_process_uses_one_thread_and_leaves_the_environment_alone():
    before = dict(os.environ)
    assert in_one_thread(os.getenv, "OMP_NUM_THREADS") == "1"
    assert dict(os.environ) == before


def test_mistakes_in_the_child_process_are_reported_here():
    with pytest.raises(UserError, match=r"missing\.npz"):
        in_one_thread(Organ.load, "missing.npz")


@pytest.mark.extended
def test_process_that_measures_ends_with_the_one_that_asked():
    """A benchmark that is killed leaves nothing behind that keeps a core busy."""
    program = "import time; from tissue_sim.bench.timing import in_one_thread; in_one_thread(time.sleep, 300)"
    asked = subprocess.Popen([sys.executable, "-c", program])

    def children():
        return [int(word) for word in Path(f"/proc/{asked.pid}/task/{asked.pid}/children").read_text().split()]

    try:
        started = wait_for(children)
    finally:
        asked.kill()
        asked.wait()
    wait_for(lambda: not any(Path(f"/proc/{process}").exists() for process in started), "they go on")
