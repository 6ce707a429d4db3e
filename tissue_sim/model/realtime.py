"""The fixed-rate loop: one compiled function that never takes the GIL.

Ticks are due by the monotonic clock, or by times that are posted (ROS's /clock). While the organ sleeps and no tool
is near, the loop naps over several ticks and does them afterwards; a bell (a semaphore) wakes it for a pose or force.
What goes in and out lies in mailboxes (tissue_sim.model.mailboxes).
"""

from __future__ import annotations

from typing import Any

from numba import types

from tissue_sim.jit import kernel, part
from tissue_sim.model.arrays import copy
from tissue_sim.model.mailboxes import (
    AWAKE_TICK,
    BEHIND,
    DROPPED,
    JOURNAL_ROWS,
    NANOSECONDS,
    NAPPING,
    OVERRUNS,
    POSTED_TIME,
    RESETS,
    ROW_RESETS,
    ROW_TICK,
    ROW_TOOLS,
    SECONDS,
    SEEN,
    SEEN_AT,
    SIM_TIME,
    STANDING,
    STARTED,
    STOP,
    WAKE_NANOSECONDS,
    WAKE_SECONDS,
    fence,
    note_tick,
    post_results,
    post_snapshot,
    take_inputs,
)
from tissue_sim.model.state import AGE, ASLEEP, FORCE_AGE, TICK, TICK_TIME
from tissue_sim.model.tool_motion import freshness
from tissue_sim.model.world import tick_implied_world, tick_world

CLOCK_MONOTONIC, TIMER_ABSTIME = 1, 1
# ns; further behind than this, ticks are dropped instead of run in a burst. Posted times come in larger steps.
LATEST_CATCH_UP, LATEST_CATCH_UP_POSTED = 50_000_000, 1_000_000_000
NAP = 4_000_000  # ns that an idle loop sleeps at most, so that simulated time is never 5 ms behind
LOOK_UP = 50_000_000  # ns after which a loop that waits for a posted time looks whether it has to end
STANDS_AFTER = 500_000_000  # ns of wall time after which a clock that doesn't move is said to stand

_clock_gettime = types.ExternalFunction("clock_gettime", types.int32(types.int32, types.intp))
_clock_nanosleep = types.ExternalFunction(
    "clock_nanosleep", types.int32(types.int32, types.int32, types.intp, types.intp)
)
_sem_clockwait = types.ExternalFunction("sem_clockwait", types.int32(types.intp, types.int32, types.intp))


@kernel
def now(clock: Any) -> int:
    """Monotonic time, ns."""
    _clock_gettime(CLOCK_MONOTONIC, clock.ctypes.data)
    return clock[SECONDS] * 1_000_000_000 + clock[NANOSECONDS]


@kernel
def sleep_until(deadline: int, clock: Any) -> None:
    """Sleep to an absolute monotonic time, ns; a signal doesn't end it early."""
    clock[WAKE_SECONDS], clock[WAKE_NANOSECONDS] = deadline // 1_000_000_000, deadline % 1_000_000_000
    while _clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, clock[WAKE_SECONDS:].ctypes.data, 0) == 4:
        pass


@kernel
def sleep_until_bell(deadline: int, box: Any) -> None:
    """Sleep until the bell is rung, or to an absolute monotonic time, ns."""
    clock = box.clock
    clock[WAKE_SECONDS], clock[WAKE_NANOSECONDS] = deadline // 1_000_000_000, deadline % 1_000_000_000
    _sem_clockwait(box.bell.ctypes.data, CLOCK_MONOTONIC, clock[WAKE_SECONDS:].ctypes.data)


@kernel
def wait_until(deadline: int, box: Any) -> int:
    """Sleep until a tick is due by the clock in use, ns; returns that clock's time.

    A posted time may not have come that far yet: then it is earlier, and the caller asks again.
    """
    control, clock = box.control, box.clock
    if control[SIM_TIME] == 0:
        sleep_until(deadline, clock)
        return now(clock)
    if control[POSTED_TIME] < deadline:
        sleep_until_bell(now(clock) + LOOK_UP, box)
    fence()
    time = control[POSTED_TIME]
    if time != clock[SEEN]:
        clock[BEHIND] = max(0, clock[SEEN] - deadline)
        clock[SEEN], clock[SEEN_AT] = time, now(clock)
    elif time < deadline and now(clock) - clock[SEEN_AT] > STANDS_AFTER:
        control[STANDING] = 1
    return time


@kernel
def is_idle(state: Any, settings: Any, box: Any, row: Any) -> bool:
    """True while the organ sleeps, no pose or force is fresh, and none has come."""
    idle = state.count[ASLEEP] == 1 and box.control[RESETS] == row[ROW_RESETS]
    for tool in range(len(state.tool_count)):
        ages, column = state.tool_count[tool], ROW_TOOLS + 2 * tool
        idle = idle and freshness(ages[AGE], settings) == 0.0 and freshness(ages[FORCE_AGE], settings) == 0.0
        idle = idle and box.pose_sequence[tool] == row[column] and box.force_sequence[tool] == row[column + 1]
    return idle


@kernel
def nap(deadline: int, state: Any, settings: Any, box: Any) -> int:
    """Sleep to an absolute monotonic time, ns, unless something is to be done sooner; returns until when it was."""
    control = box.control
    control[NAPPING] = 1
    fence()  # from here on whoever posts rings
    if is_idle(state, settings, box, box.row):
        sleep_until_bell(deadline, box)
    control[NAPPING] = 0
    return min(now(box.clock), deadline)


@part
def _loop(world: Any, tick: Any, box: Any, floats: Any, integers: Any) -> None:
    model, state, settings, control = world.model, world.state, world.settings, box.control
    row = box.row
    post_results(world, box, True)  # the rest shape
    control[STARTED] = 1
    moved = False
    followed, due = -1, 0  # the clock that ticks follow, and when the last one was due by it; 0 before its first time
    while control[STOP] == 0:
        post_snapshot(box, floats, integers)
        posted = control[SIM_TIME]
        if posted != followed:
            followed, due = posted, 0 if posted == 1 else now(box.clock)
            control[STANDING] = posted  # until its first tick
        period = int(settings[TICK_TIME] * 1e9 + 0.5)
        if posted == 0 and 2 * period <= NAP and is_idle(state, settings, box, row):
            rested = nap(due + NAP // period * period, state, settings, box)
            while due + 2 * period <= rested:
                due += period
                begin = now(box.clock)
                tick(world)
                note_tick(box, due, period, 0, now(box.clock) - begin)
        start = wait_until(due + period, box)
        if due == 0 or start < due:  # the first time that was posted, or it jumped back
            due = start
        if start < due + period:
            continue
        due += period
        late = start - due
        begin = start
        if late > (LATEST_CATCH_UP_POSTED if posted == 1 else LATEST_CATCH_UP):
            control[DROPPED] += late // period
            due = start
        if posted == 1:  # a posted time makes many ticks due at once; late is what was left of the one before
            begin, late, box.clock[BEHIND] = now(box.clock), box.clock[BEHIND], 0
        if late > period:
            control[OVERRUNS] += 1
        resets = row[ROW_RESETS]
        if take_inputs(model, state, settings, box, row):
            moved = moved or row[ROW_RESETS] != resets
            row[ROW_TICK] = state.count[TICK] + 1
            copy(row, box.journal[box.journal_written[0] % JOURNAL_ROWS])
            fence()
            box.journal_written[0] += 1
        tick(world)
        moved = moved or state.count[ASLEEP] == 0
        post_results(world, box, moved)
        control[STANDING] = 0
        if moved:
            control[AWAKE_TICK] = state.count[TICK]
        moved = False
        note_tick(box, due, period, late, now(box.clock) - begin)


@kernel
def run_loop(world: Any, box: Any, floats: Any, integers: Any) -> None:
    """Tick every settings[TICK_TIME] s until control[STOP]; floats and integers are the state's flat buffers."""
    _loop(world, tick_world, box, floats, integers)


@kernel
def run_implied_loop(world: Any, box: Any, floats: Any, integers: Any) -> None:
    """The same where return springs pull to the boundary that the skeleton implies."""
    _loop(world, tick_implied_world, box, floats, integers)
