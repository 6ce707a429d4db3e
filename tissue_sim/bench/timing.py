"""Timing of small pieces of work in one run: round-robin in bursts, so that noise affects all alike.

Time is processor time of this thread, minus the cost of reading its clock: a piece of work that another program
interrupts takes no longer for it.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import time
from collections.abc import Callable, Mapping
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import nullcontext
from functools import cache
from types import FrameType
from typing import NamedTuple

import numba
import numpy as np
from numba import types
from numpy.typing import NDArray

from tissue_sim import interrupts, progress
from tissue_sim.array_types import Floats, Longs
from tissue_sim.bench import rows
from tissue_sim.environment import environment
from tissue_sim.errors import UserError
from tissue_sim.model.data.world import World
from tissue_sim.model.simulation import Simulation
from tissue_sim.model.stepping.guard import check_cells, guard
from tissue_sim.model.stepping.inputs import load_nodes, take_pose
from tissue_sim.model.stepping.tick import tick
from tissue_sim.parent_exit import exit_with_parent

Burst = Callable[[int], Floats]  # count -> seconds (count,) that each of count calls took

ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
LONG = 1.0  # s of a burst beside which the progress thread may run, as it is negligible there
BURST = 0.02  # s of measuring one piece of work before the next one's turn
LEAST_SAMPLES = 3
_LOAD_PERIOD = 200  # ticks in which a load rises from zero and falls back
_NOISE_TURNS = 30_000  # iterations of the fixed loop, about 0.1 ms

CLOCK_THREAD_CPUTIME_ID = 3
_clock_gettime = types.ExternalFunction("clock_gettime", types.int32(types.int32, types.intp))


class Timing(NamedTuple):
    """Time of one piece of work: median and 99th percentile, s, and the number of samples."""

    median: float
    p99: float
    samples: int


class Phase(NamedTuple):
    """Pieces of work that are measured in turns, the seconds of measuring for each, and their description."""

    bursts: Mapping[str, Burst]
    seconds: float
    label: str


def describe(samples: Floats) -> Timing:
    """Return the timing of samples (k,) s; raises ValueError without any."""
    median, p99 = np.percentile(samples, [50.0, 99.0])
    return Timing(float(median), float(p99), len(samples))


def interleave(phase: Phase) -> dict[str, Timing]:
    """Measure every burst of a phase in turns, each for `seconds` in total (but at least three times).

    Ctrl-C ends it with what was measured so far: nothing, where not every burst has run.

    Returns timings by name.
    """
    rounds = max(LEAST_SAMPLES, round(phase.seconds / BURST))
    samples: dict[str, list[Floats]] = {}
    with rows.until_stopped():
        first = {}
        for name in rows.each(phase.bursts, f"{phase.label}, first pass"):
            first[name] = phase.bursts[name](2)
            progress.say(f"{name}: first pass {1e6 * first[name].min():.3g} us")
        samples = {name: [] for name in first}
        rows.keep()
        quickest = {name: max(float(seconds.min()), 1e-9) for name, seconds in first.items()}
        counts = {name: max(1, int(BURST / seconds)) for name, seconds in quickest.items()}
        with progress.still(), progress.task(phase.label, rounds) as under_way:
            for turn in range(0 if rows.stopped() else rounds):
                for name, burst in phase.bursts.items():
                    spent = float(sum(part.sum() for part in samples[name]))
                    # What takes long comes less often, spread over the run.
                    due = len(samples[name]) < LEAST_SAMPLES * (turn + 1) / rounds
                    if due or spent <= phase.seconds * turn / rounds:
                        with progress.moving() if counts[name] * quickest[name] > LONG else nullcontext():
                            samples[name].append(burst(counts[name]))
                    under_way.advance(0)
                under_way.advance()
    return {name: describe(np.concatenate(parts or [first[name]])) for name, parts in samples.items()}


def in_one_thread[Result](function: Callable[..., Result], *arguments: object) -> Result:
    """Call a function of a module in a new process whose numerical libraries use one thread.

    They read their number of threads when they are loaded, so a process of its own is needed; that reports its
    progress, and Ctrl-C ends it with what it has measured.
    """
    context = multiprocessing.get_context("spawn")
    try:
        with (
            environment(dict.fromkeys(ONE_THREAD, "1")),
            progress.still(),
            ProcessPoolExecutor(1, mp_context=context, initializer=_begin) as pool,
        ):
            under_way = pool.submit(_measured, progress.name_of_all(), function, arguments)
            try:
                found, stopped = under_way.result()
            except KeyboardInterrupt:
                _signal_children(signal.SIGINT)  # where it was not the terminal that sent it to all
                try:
                    found, stopped = under_way.result()
                except KeyboardInterrupt:  # nothing was measured, or Ctrl-C came once more
                    _signal_children(signal.SIGKILL)
                    raise
    except BrokenProcessPool:
        raise UserError("the measuring process was killed; there may not have been enough memory") from None
    if stopped:
        rows.stop()
    return found


def _begin() -> None:
    """Let Ctrl-C interrupt this process once, from any sender, so that its measurements are handed over."""

    def interrupt(number: int, frame: FrameType | None) -> None:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        interrupts.interrupt(number, frame)

    exit_with_parent()
    signal.signal(signal.SIGINT, interrupt)


def _measured[Result](name: str, function: Callable[..., Result], arguments: tuple[object, ...]) -> tuple[Result, bool]:
    """Return what a function returns, and whether it was stopped before its end."""
    with progress.task(name or "measuring"):
        return function(*arguments), rows.stopped()


def _signal_children(number: signal.Signals) -> None:
    for child in multiprocessing.active_children():
        if child.pid is not None:
            os.kill(child.pid, number)


# the clock ---------------------------------------------------------------------------------------


@numba.njit(nogil=True)
def now(clock: Longs) -> int:
    """Return the processor time of this thread, ns. clock (2,): buffer for the timespec."""
    _clock_gettime(CLOCK_THREAD_CPUTIME_ID, clock.ctypes.data)
    return clock[0] * 1_000_000_000 + clock[1]


@numba.njit(nogil=True)
def _time_nothing(clock: Longs, times: Longs) -> None:
    for index in range(len(times)):
        start = now(clock)
        times[index] = now(clock) - start


@cache
def clock_cost() -> float:
    """Return the median time that reading the clock adds to a piece of work, s."""
    times = np.zeros(2000, dtype=np.int64)
    _time_nothing(np.zeros(2, dtype=np.int64), times)
    return 1e-9 * float(np.median(times))


def time_calls(work: Callable[[], object], count: int) -> Floats:
    """Return the times of calls from Python, after two more that warm the caches, (count,) s."""
    seconds = np.zeros(count + 2)
    for index in range(len(seconds)):
        start = time.thread_time_ns()
        work()
        seconds[index] = 1e-9 * (time.thread_time_ns() - start)
    return np.maximum(seconds[2:] - clock_cost(), 0.0)


# ticks -------------------------------------------------------------------------------------------


@numba.njit(nogil=True, error_model="numpy")
def swelling(phase: Longs) -> float:
    """Return the fraction of a load that rises and falls five times a second.

    phase (1,): the tick, which advances by one.
    """
    fraction = 0.5 * (1.0 - np.cos(2.0 * np.pi * phase[0] / _LOAD_PERIOD))
    phase[0] = phase[0] % _LOAD_PERIOD + 1
    return fraction


class _Load(NamedTuple):
    """What acts on an organ while its ticks are timed."""

    nodes: NDArray[np.int64]  # (k,)
    forces: Floats  # (k, 3) N
    steady: bool  # all of it in every tick; else it swells and ebbs
    phase: NDArray[np.int64]  # (1,) tick of the swelling


@numba.njit(nogil=True, error_model="numpy")
def _time_ticks(world: World, load: _Load, guarded: bool, clock: Longs, times: Longs) -> None:
    """Step len(times) ticks under a _Load and write the ns that each took, or its guard alone.

    In a compiled loop, as in the node, so that no call from Python is in the figure. Not kept on disk, where nothing
    would show that the kernels of the model, in another layer, have changed.
    """
    model, state, settings, scratch = world.model, world.state, world.settings, world.scratch
    for index in range(len(times)):
        if len(load.nodes) > 0:
            fraction = swelling(load.phase)
            load_nodes(state, load.nodes, (1.0 if load.steady else fraction) * load.forces)
        for tool in range(len(state.body_pose)):
            goal = state.body_goal[tool].copy()
            take_pose(world, tool, goal, 0, state.bodies[tool].pose_sequence + 1)
        start = now(clock)
        tick(world)
        if guarded:  # once more, after a tick as in it
            start = now(clock)
            guard(model, state, settings, scratch)
            check_cells(model, state, scratch)
        times[index] = now(clock) - start


class Ticks:
    """Bursts of ticks of a simulation under forces that rise and fall five times a second.

    Without nodes the organ is left alone. Tools get their unchanged poses again before each tick.

    nodes (k,): loaded nodes; forces (k, 3) N: forces on them; steady: whether every burst begins at rest, under the
    full force; guard: whether only the guard of each tick is timed.
    """

    def __init__(
        self,
        simulation: Simulation,
        nodes: NDArray[np.int64],
        forces: Floats,
        *,
        steady: bool = False,
        guard: bool = False,
    ) -> None:
        self.simulation = simulation
        self.guard = guard
        self._load = _Load(
            np.asarray(nodes, dtype=np.int64),
            np.ascontiguousarray(forces, dtype=np.float64),
            steady,
            np.full(1, _LOAD_PERIOD // 4),
        )
        self._clock = np.zeros(2, dtype=np.int64)

    def swing(self) -> None:
        """Raise the load from rest and lower it once, without measuring."""
        self.simulation.reset()
        self._load.phase[0] = 0
        self(_LOAD_PERIOD)

    def __call__(self, count: int) -> Floats:
        """Return the seconds (count,) of `count` ticks, after two more that warm the caches."""
        simulation = self.simulation
        if self._load.steady:
            simulation.reset()
        times = np.zeros(count + 2, dtype=np.int64)
        _time_ticks(simulation.world, self._load, self.guard, self._clock, times)
        return np.maximum(1e-9 * times[2:] - clock_cost(), 0.0)


# noise -------------------------------------------------------------------------------------------


@numba.njit(nogil=True)
def _time_arithmetic(clock: Longs, times: Longs) -> float:
    """Run a fixed loop that touches no memory, and write the ns of each turn."""
    x = 0.5
    for index in range(len(times)):
        start = now(clock)
        for _ in range(_NOISE_TURNS):
            x = 3.7 * x * (1.0 - x)
        times[index] = now(clock) - start
    return x


def noise_burst(count: int) -> Floats:
    """Return the times of a fixed loop of arithmetic, whose scatter is that of the machine, (count,) s."""
    times = np.zeros(count, dtype=np.int64)
    _time_arithmetic(np.zeros(2, dtype=np.int64), times)
    return np.maximum(1e-9 * times - clock_cost(), 0.0)
