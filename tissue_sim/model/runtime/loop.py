"""Fixed-rate loop: one compiled function that never takes the GIL.

Ticks are due by the monotonic clock, or by posted times (ROS's /clock). With the monotonic clock, a pose or force makes
the next tick start early, by a period at most: no tick begins before the previous one was due, so that the number of
ticks remains that of the clock. While organs sleep and no tool is near, the loop sleeps for several ticks and computes
them afterwards; a bell (a semaphore) wakes it for a pose or force.

Inputs and outputs are in mailboxes (tissue_sim.model.runtime.mailboxes).
"""

from __future__ import annotations

from collections.abc import Sequence

from numba import types

from tissue_sim.array_types import Longs
from tissue_sim.jit import kernel
from tissue_sim.model.contact.tool_motion import freshness
from tissue_sim.model.data.world import World
from tissue_sim.model.runtime.exchange import Exchange, preload, take_exchange
from tissue_sim.model.runtime.joined_box import JoinedBox, post_haptic_output, snapshot_joined, take_joined
from tissue_sim.model.runtime.mailboxes import (
    Control,
    LoopWords,
    Mailboxes,
    RequestPhase,
    fence,
    note_tick,
    post_results,
    snapshot_states,
    take_inputs,
)
from tissue_sim.model.stepping.breathing import note_gravity
from tissue_sim.model.stepping.coupled_step import CoupledOrgans, tick_coupled, uncouple

CLOCK_MONOTONIC, TIMER_ABSTIME = 1, 1
# ns; if the loop is further behind, ticks are dropped instead of run in a burst. Posted times have larger steps.
LATEST_CATCH_UP, LATEST_CATCH_UP_POSTED = 50_000_000, 1_000_000_000
MAX_WAITS = 2  # see wait_for_tick
SHIFTS = 32  # requests until most of a wrong phase is corrected
NAP = 4_000_000  # ns, longest sleep of an idle loop, so that simulated time is never 5 ms behind
STOP_CHECK_INTERVAL = 50_000_000  # ns after which a loop that waits for a posted time checks whether it must end
STOPPED_AFTER = 500_000_000  # ns of wall time after which a clock that doesn't advance counts as stopped

_clock_gettime = types.ExternalFunction("clock_gettime", types.int32(types.int32, types.intp))
_clock_nanosleep = types.ExternalFunction(
    "clock_nanosleep", types.int32(types.int32, types.int32, types.intp, types.intp)
)
_sem_post = types.ExternalFunction("sem_post", types.int32(types.intp))
_sem_clockwait = types.ExternalFunction("sem_clockwait", types.int32(types.intp, types.int32, types.intp))


@kernel
def now(timespec: Longs) -> int:
    """Return the monotonic time.

    Parameters
    ----------
    timespec : Longs, shape (2,)
        Buffer.

    Returns
    -------
    int, ns
        The time.
    """
    _clock_gettime(CLOCK_MONOTONIC, timespec.ctypes.data)
    return timespec[0] * 1_000_000_000 + timespec[1]


@kernel
def set_time(time: int, timespec: Longs) -> None:
    """Write an absolute time, ns, as the system's calls take it."""
    timespec[0], timespec[1] = time // 1_000_000_000, time % 1_000_000_000


@kernel
def sleep_until(deadline: int, timespec: Longs) -> None:
    """Sleep to an absolute monotonic time; a signal doesn't end it early.

    Parameters
    ----------
    deadline : int, ns
        The time.
    timespec : Longs, shape (2,)
        Buffer.
    """
    set_time(deadline, timespec)
    while _clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, timespec.ctypes.data, 0) == 4:
        pass


@kernel
def sleep_until_bell(deadline: int, loop: LoopWords) -> None:
    """Sleep until the bell is rung, or to an absolute monotonic time, ns."""
    set_time(deadline, loop.wake)
    _sem_clockwait(loop.bell.ctypes.data, CLOCK_MONOTONIC, loop.wake.ctypes.data)


@kernel
def wait_until(deadline: int, loop: LoopWords) -> int:
    """Sleep until a tick is due by a posted time, ns; return the time that was posted.

    That time may be before the deadline: then the caller waits again.
    """
    control, phase = loop.control, loop.phase
    if control.posted_time < deadline:
        sleep_until_bell(now(loop.now) + STOP_CHECK_INTERVAL, loop)
    fence()
    time = control.posted_time
    if time != phase.seen:
        phase.behind = max(0, phase.seen - deadline)
        phase.seen, phase.seen_at = time, now(loop.now)
    elif time < deadline and now(loop.now) - phase.seen_at > STOPPED_AFTER:
        control.standing = True
    return time


@kernel
def wait_for_tick(due: int, period: int, answered: int, loop: LoopWords) -> int:
    """Sleep until a tick is due by the monotonic clock, a period after `due`, ns, or is requested.

    answered: control.asked when the last tick began. Returns the time, which is `due` or later. A request before `due`
    waits, and its tick uses up the time of the next one: in a stream of poses with the rate of the ticks, all would
    wait like that. Therefore, after MAX_WAITS such requests in a row, a tick waits for the next request.
    """
    control, phase, time = loop.control, loop.phase, now(loop.now)
    early = answered  # control.asked with all requests before `due`
    while time < due + period:
        control.waiting = True
        fence()  # from here on a post rings the bell
        asked, deadline = control.asked, due + period
        if time < due:
            early = asked
        if phase.waits < MAX_WAITS or asked != early:
            if asked != answered and time >= due:
                break
            deadline = due if asked != answered else deadline
        sleep_until_bell(deadline, loop)
        time = now(loop.now)
    control.waiting = False
    phase.waits = phase.waits + 1 if control.asked == early == answered + 1 and phase.waits < MAX_WAITS else 0
    return time


@kernel
def suited_due(due: int, start: int, period: int, phase: RequestPhase) -> int:
    """Return when an early tick was due, ns, shifted so that requests arrive midway between two due times.

    In a stream with the rate of the ticks, a request that arrives a little early then needn't wait, and for one that
    arrives a little late no tick has begun without it. The sum of all shifts is at most half a period.
    """
    shift = (start - due - period // 2) // SHIFTS
    if abs(phase.shift + shift) > period // 2:
        return due
    phase.shift += shift
    return due + shift


@kernel
def is_idle(world: World, box: Mailboxes, resets: int) -> bool:
    """Return whether an organ sleeps, no pose or force is fresh, and none has arrived."""
    state, settings = world.state, world.settings
    idle = state.status.asleep and resets == box.row.resets
    for body in range(len(state.bodies)):
        status, taken = state.bodies[body], box.inputs[body]
        idle = idle and freshness(status.age, settings) == 0.0 and freshness(status.force_age, settings) == 0.0
        idle = idle and box.pose.sequence[body] == taken.pose and box.force.sequence[body] == taken.force
    return idle


@kernel
def all_idle(worlds: Sequence[World], boxes: Sequence[Mailboxes], control: Control) -> bool:
    """Return whether all organs are idle."""
    resets, idle = control.resets, True
    for organ in range(len(worlds)):
        idle = idle and is_idle(worlds[organ], boxes[organ], resets)
    return idle


@kernel
def nap(deadline: int, worlds: Sequence[World], boxes: Sequence[Mailboxes], loop: LoopWords) -> int:
    """Sleep to an absolute monotonic time, ns, unless something is due sooner; return the time until which it slept."""
    control = loop.control
    control.napping = True
    fence()  # from here on a post rings the bell
    if all_idle(worlds, boxes, control):
        sleep_until_bell(deadline, loop)
    control.napping = False
    return min(now(loop.now), deadline)


@kernel
def take_all(
    worlds: Sequence[World],
    boxes: Sequence[Mailboxes],
    resets: int,
    joined: CoupledOrgans | None,
    joined_box: JoinedBox,
) -> None:
    """Apply all inputs: a reset uncouples organs; gravity in new settings is that without the breath."""
    if joined is None:
        take_inputs(worlds[0], boxes[0], resets)
        return
    was_reset = resets != boxes[0].row.resets
    for organ in range(len(worlds)):
        row, before = boxes[organ].row, boxes[organ].row.settings
        take_inputs(worlds[organ], boxes[organ], resets)
        if row.settings != before:
            note_gravity(worlds[organ].settings, joined.carried, organ)
    if was_reset:
        uncouple(worlds, joined)
    take_joined(joined, joined_box, worlds[0].state.status.tick + 1)


@kernel
def post_all(
    worlds: Sequence[World], boxes: Sequence[Mailboxes], joined: CoupledOrgans | None, joined_box: JoinedBox
) -> None:
    """Post the results of every organ, and the haptic output of all."""
    for organ in range(len(worlds)):
        post_results(worlds[organ], boxes[organ])
    post_haptic_output(worlds, joined, joined_box)


@kernel
def snapshot_all(
    worlds: Sequence[World], boxes: Sequence[Mailboxes], joined: CoupledOrgans | None, joined_box: JoinedBox
) -> None:
    """Copy the states of all organs, and that of everything that joins them."""
    snapshot_states(worlds, boxes)
    if joined is not None:
        snapshot_joined(joined, joined_box, worlds[0].state.status.tick)


@kernel
def run_loop(
    worlds: Sequence[World],
    boxes: Sequence[Mailboxes],
    loop: LoopWords,
    joined: CoupledOrgans | None,
    joined_box: JoinedBox,
    exchange: Exchange,
) -> None:
    """Tick a row of worlds, each with its mailboxes, every settings.tick_time s of the first one until control.stop.

    joined: what joins the organs, see `coupled_step.CoupledOrgans`; None for a single organ, compiled without coupling.
    exchange: new arrays for an organ, used from between two ticks on.
    """
    settings, control, phase = worlds[0].settings, loop.control, loop.phase
    for organ in range(len(boxes)):
        boxes[organ].demand.moved = True  # the rest shape
    post_all(worlds, boxes, joined, joined_box)
    control.last_wait = now(loop.now)
    control.started = True
    due = 0  # when the last tick was due by the clock that ticks follow; 0 before its first time
    answered = 0  # control.asked when the last tick began
    posted = not control.sim_time
    while not control.stop:
        control.last_wait = now(loop.now)
        asked = control.snapshot_asked
        if asked != control.snapshot_done:
            snapshot_all(worlds, boxes, joined, joined_box)
            fence()
            control.snapshot_done = asked
        if posted != control.sim_time:
            posted = control.sim_time
            due = 0 if posted else now(loop.now)
            control.standing = posted  # until its first tick
        period = int(settings.tick_time * 1e9 + 0.5)
        if not posted and 2 * period <= NAP and all_idle(worlds, boxes, control):
            rested = nap(due + NAP // period * period, worlds, boxes, loop)
            while due + 2 * period <= rested:
                due += period
                begin = now(loop.now)
                tick_coupled(worlds, joined)
                note_tick(loop, due, period, 0, now(loop.now) - begin)
        if posted:
            start = wait_until(due + period, loop)
            if due == 0 or start < due:  # the first time that was posted, or it jumped back
                due = start
            if start < due + period:
                continue
        else:
            start = wait_for_tick(due, period, answered, loop)
            if start < due + period and control.asked == answered + 1:
                due = suited_due(due, start, period, phase)
        due += period
        late = max(0, start - due)
        begin = start
        if late > (LATEST_CATCH_UP_POSTED if posted else LATEST_CATCH_UP):
            control.dropped += late // period
            due = start
        if posted:  # a posted time makes many ticks due at once; lateness is the remaining lag behind the previous one
            begin, late, phase.behind = now(loop.now), phase.behind, 0
        if late > period:
            control.overruns += 1
        before, answered = answered, control.asked
        fence()  # inputs posted before the request are applied
        exchanged = exchange.words.asked
        is_due = exchanged != exchange.words.done
        is_taken = is_due and (posted or exchange.words.loaded == exchanged)
        if is_taken:
            take_exchange(worlds, boxes, joined, exchange)
        take_all(worlds, boxes, control.resets, joined, joined_box)
        tick_coupled(worlds, joined)
        post_all(worlds, boxes, joined, joined_box)
        fence()
        if is_taken:
            exchange.words.done = exchanged
        if answered != before:
            _sem_post(loop.answered.ctypes.data)
        control.standing = False
        note_tick(loop, due, period, late, now(loop.now) - begin)
        if is_due and not is_taken:
            preload(exchange.worlds[0])
            exchange.words.loaded = exchanged
