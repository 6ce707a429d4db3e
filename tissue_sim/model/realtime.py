"""The fixed-rate loop: one compiled function that never takes the GIL.

Ticks are due by the monotonic clock, or by times that are posted (ROS's /clock). While the organ sleeps and no tool
is near, the loop naps over several ticks and does them afterwards; a bell (a semaphore) wakes it for a pose or force.
What goes in and out lies in mailboxes (tissue_sim.model.mailboxes).
"""

from __future__ import annotations

from typing import Any

from numba import types

from tissue_sim.jit import kernel, part
from tissue_sim.model.mailboxes import fence, note_tick, post_results, post_snapshot, take_inputs, write_journal
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
def now(timespec: Any) -> int:
    """Monotonic time, ns; timespec (2,) is room."""
    _clock_gettime(CLOCK_MONOTONIC, timespec.ctypes.data)
    return timespec[0] * 1_000_000_000 + timespec[1]


@kernel
def set_time(time: int, timespec: Any) -> None:
    """Write an absolute time, ns, as the system's calls take it."""
    timespec[0], timespec[1] = time // 1_000_000_000, time % 1_000_000_000


@kernel
def sleep_until(deadline: int, timespec: Any) -> None:
    """Sleep to an absolute monotonic time, ns; a signal doesn't end it early. timespec (2,) is room."""
    set_time(deadline, timespec)
    while _clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, timespec.ctypes.data, 0) == 4:
        pass


@kernel
def sleep_until_bell(deadline: int, box: Any) -> None:
    """Sleep until the bell is rung, or to an absolute monotonic time, ns."""
    set_time(deadline, box.wake)
    _sem_clockwait(box.bell.ctypes.data, CLOCK_MONOTONIC, box.wake.ctypes.data)


@kernel
def wait_until(deadline: int, box: Any) -> int:
    """Sleep until a tick is due by the clock in use, ns; returns that clock's time.

    A posted time may not have come that far yet: then it is earlier, and the caller asks again.
    """
    control, pace = box.control, box.pace
    if not control.sim_time:
        sleep_until(deadline, box.wake)
        return now(box.now)
    if control.posted_time < deadline:
        sleep_until_bell(now(box.now) + LOOK_UP, box)
    fence()
    time = control.posted_time
    if time != pace.seen:
        pace.behind = max(0, pace.seen - deadline)
        pace.seen, pace.seen_at = time, now(box.now)
    elif time < deadline and now(box.now) - pace.seen_at > STANDS_AFTER:
        control.standing = True
    return time


@kernel
def is_idle(world: Any, box: Any) -> bool:
    """True while the organ sleeps, no pose or force is fresh, and none has come."""
    state, settings = world.state, world.settings
    idle = state.status.asleep and box.control.resets == box.row.resets
    for body in range(len(state.bodies)):
        status, taken = state.bodies[body], box.inputs[body]
        idle = idle and freshness(status.age, settings) == 0.0 and freshness(status.force_age, settings) == 0.0
        idle = idle and box.pose.sequence[body] == taken.pose and box.force.sequence[body] == taken.force
    return idle


@kernel
def nap(deadline: int, world: Any, box: Any) -> int:
    """Sleep to an absolute monotonic time, ns, unless something is to be done sooner; returns until when it was."""
    control = box.control
    control.napping = True
    fence()  # from here on whoever posts rings
    if is_idle(world, box):
        sleep_until_bell(deadline, box)
    control.napping = False
    return min(now(box.now), deadline)


@part
def _loop(world: Any, tick: Any, box: Any) -> None:
    state, settings, control, pace = world.state, world.settings, box.control, box.pace
    post_results(world, box, True)  # the rest shape
    control.looked_up = now(box.now)
    control.started = True
    moved = False
    due = 0  # when the last tick was due by the clock that ticks follow; 0 before its first time
    posted = not control.sim_time
    while not control.stop:
        control.looked_up = now(box.now)
        post_snapshot(state, box)
        if posted != control.sim_time:
            posted = control.sim_time
            due = 0 if posted else now(box.now)
            control.standing = posted  # until its first tick
        period = int(settings.tick_time * 1e9 + 0.5)
        if not posted and 2 * period <= NAP and is_idle(world, box):
            rested = nap(due + NAP // period * period, world, box)
            while due + 2 * period <= rested:
                due += period
                begin = now(box.now)
                tick(world)
                note_tick(box, due, period, 0, now(box.now) - begin)
        start = wait_until(due + period, box)
        if due == 0 or start < due:  # the first time that was posted, or it jumped back
            due = start
        if start < due + period:
            continue
        due += period
        late = start - due
        begin = start
        if late > (LATEST_CATCH_UP_POSTED if posted else LATEST_CATCH_UP):
            control.dropped += late // period
            due = start
        if posted:  # a posted time makes many ticks due at once; late is what was left of the one before
            begin, late, pace.behind = now(box.now), pace.behind, 0
        if late > period:
            control.overruns += 1
        resets = box.row.resets
        if take_inputs(world, box):
            moved = moved or box.row.resets != resets
            write_journal(box, state.status.tick + 1)
        tick(world)
        moved = moved or not state.status.asleep
        post_results(world, box, moved)
        control.standing = False
        if moved:
            control.awake_tick = state.status.tick
        moved = False
        note_tick(box, due, period, late, now(box.now) - begin)


@kernel
def run_loop(world: Any, box: Any) -> None:
    """Tick every settings.tick_time s until control.stop."""
    _loop(world, tick_world, box)


@kernel
def run_implied_loop(world: Any, box: Any) -> None:
    """The same where return springs pull to the boundary that the skeleton implies."""
    _loop(world, tick_implied_world, box)
