"""The fixed-rate loop: one compiled function that never takes the GIL.

Python and the loop exchange data through mailboxes in shared arrays. A mailbox has a sequence
number and a few slots: the writer fills slot `(sequence + 1) % slots` and then raises the number;
the reader copies slot `sequence % slots` and accepts it if the writer can't have come round to
it meanwhile. Nobody waits for anybody.

Ticks are due by the monotonic clock, or by times that are posted (ROS's /clock). While the organ sleeps and no tool
is near, the loop naps over several ticks and does them afterwards; a bell (a semaphore) wakes it for a pose or force.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import types
from numba.extending import intrinsic

from tissue_sim.jit import kernel, part
from tissue_sim.model.arrays import copy
from tissue_sim.model.inputs import reset_state, take_contacts, take_force, take_pose
from tissue_sim.model.modal_region import place_outside
from tissue_sim.model.state import (
    AGE,
    ASLEEP,
    FORCE_AGE,
    MAX_ENTRIES,
    MODAL,
    N_COUNT,
    N_SETTINGS,
    REGION,
    TICK,
    TICK_TIME,
    Floats,
    Longs,
    StateBuffer,
)
from tissue_sim.model.tool_motion import freshness
from tissue_sim.model.world import tick_implied_world, tick_world

IN_SLOTS = 3
OUT_SLOTS = 4
JOURNAL_ROWS = 8192
TIMING_ROWS = 8192

# Columns of Mailboxes.control.
STOP, RESETS, SNAPSHOT_ASKED, SNAPSHOT_DONE, LOOP_TICKS, OVERRUNS, DROPPED, AWAKE_TICK = range(8)
SURFACE_ASKED, SURFACE_DONE = 8, 9
ON_DEMAND = 10  # 1 while positions are handed out only when asked for, because most of them are not worked out
STARTED = 11  # 1 when the loop runs and has handed out the rest shape
SIMULATED = 12  # ns of simulated time
DUE = 13  # ns of the clock in use: when the last tick was due
NAPPING = 14  # 1 while the loop sleeps over several ticks
SIM_TIME = 15  # 1 while ticks follow POSTED_TIME, 0 the monotonic clock
POSTED_TIME = 16  # ns, newest time of /clock; 0 before the first one
STANDING = 17  # 1 while /clock gives no time, or has stood still for a while
N_CONTROL = 18

# First columns of a journal row; then pose and force sequence of each tool.
ROW_TICK, ROW_CONTACTS, ROW_SETTINGS, ROW_RESETS, ROW_TOOLS = range(5)

CLOCK_MONOTONIC, TIMER_ABSTIME = 1, 1
# ns; further behind than this, ticks are dropped instead of run in a burst. Posted times come in larger steps.
LATEST_CATCH_UP, LATEST_CATCH_UP_POSTED = 50_000_000, 1_000_000_000
NAP = 4_000_000  # ns that an idle loop sleeps at most, so that simulated time is never 5 ms behind
LOOK_UP = 50_000_000  # ns after which a loop that waits for a posted time looks whether it has to end
STANDS_AFTER = 500_000_000  # ns of wall time after which a clock that doesn't move is said to stand

# Columns of Mailboxes.clock: two timespecs; the newest posted time that the loop has seen, when it saw that, and how
# far it still was from the one before.
SECONDS, NANOSECONDS, WAKE_SECONDS, WAKE_NANOSECONDS, SEEN, SEEN_AT, BEHIND = range(7)

_clock_gettime = types.ExternalFunction("clock_gettime", types.int32(types.int32, types.intp))
_clock_nanosleep = types.ExternalFunction(
    "clock_nanosleep", types.int32(types.int32, types.int32, types.intp, types.intp)
)
_sem_clockwait = types.ExternalFunction("sem_clockwait", types.int32(types.intp, types.int32, types.intp))


class Mailboxes(NamedTuple):
    """Shared arrays between the loop and Python. T tools, n nodes, C contact set entries."""

    pose_sequence: Longs  # (T,)
    pose: Floats  # (3, T, 7)
    taken_pose: Floats  # (T, 7) the loop's copy
    force_sequence: Longs  # (T,)
    force: Floats  # (3, T, 3)
    contact_sequence: Longs  # (1,)
    contact_entries: Longs  # (3,)
    contact_tool: Longs  # (3, C)
    contact_node: Longs  # (3, C, 3)
    contact_weight: Floats  # (3, C, 3)
    contact_normal: Floats  # (3, C, 3)
    tip_node: Longs  # (3, T, 3)
    tip_weight: Floats  # (3, T, 3)
    engaged: Longs  # (3, T)
    settings_sequence: Longs  # (1,)
    settings: Floats  # (3, N_SETTINGS)
    out_sequence: Longs  # (1,) small results, after every tick
    out_wrench: Floats  # (4, T, 6)
    out_count: Longs  # (4, N_COUNT)
    out_tool_count: Longs  # (4, T, N_TOOL_COUNT)
    surface_sequence: Longs  # (1,) positions, after every tick that moved, or that was asked
    surface_tick: Longs  # (4,)
    surface: Floats  # (4, n, 3)
    control: Longs  # (N_CONTROL,)
    snapshot_floats: Floats
    snapshot_integers: Longs
    journal_written: Longs  # (1,)
    journal: Longs  # (JOURNAL_ROWS, ROW_TOOLS + 2 T) what each tick took up, where anything changed
    timing: Longs  # (TIMING_ROWS, 2) ns: lateness and duration of each tick
    clock: Longs  # (7,) what the loop notes about the time
    bell: Longs  # (4,) a sem_t, posted to wake the loop
    row: Longs  # (ROW_TOOLS + 2 T,) of the journal, as the last tick took it up


def make_mailboxes(buffer: StateBuffer) -> Mailboxes:
    """Empty mailboxes for a simulation's state buffer."""
    state = buffer.state
    n, n_tools = len(state.position), len(state.tool_pose)

    def floats(*shape: int) -> Floats:
        return np.zeros(shape)

    def longs(*shape: int) -> Longs:
        return np.zeros(shape, dtype=np.int64)

    return Mailboxes(
        pose_sequence=longs(n_tools),
        pose=floats(IN_SLOTS, n_tools, 7),
        taken_pose=floats(n_tools, 7),
        force_sequence=longs(n_tools),
        force=floats(IN_SLOTS, n_tools, 3),
        contact_sequence=longs(1),
        contact_entries=longs(IN_SLOTS),
        contact_tool=longs(IN_SLOTS, MAX_ENTRIES),
        contact_node=longs(IN_SLOTS, MAX_ENTRIES, 3),
        contact_weight=floats(IN_SLOTS, MAX_ENTRIES, 3),
        contact_normal=floats(IN_SLOTS, MAX_ENTRIES, 3),
        tip_node=longs(IN_SLOTS, n_tools, 3),
        tip_weight=floats(IN_SLOTS, n_tools, 3),
        engaged=longs(IN_SLOTS, n_tools),
        settings_sequence=longs(1),
        settings=floats(IN_SLOTS, N_SETTINGS),
        out_sequence=longs(1),
        out_wrench=floats(OUT_SLOTS, n_tools, 6),
        out_count=longs(OUT_SLOTS, N_COUNT),
        out_tool_count=longs(OUT_SLOTS, *state.tool_count.shape),
        surface_sequence=longs(1),
        surface_tick=longs(OUT_SLOTS),
        surface=floats(OUT_SLOTS, n, 3),
        control=longs(N_CONTROL),
        snapshot_floats=floats(len(buffer.floats)),
        snapshot_integers=longs(len(buffer.integers)),
        journal_written=longs(1),
        journal=longs(JOURNAL_ROWS, ROW_TOOLS + 2 * n_tools),
        timing=longs(TIMING_ROWS, 2),
        clock=longs(7),
        bell=longs(4),
        row=longs(ROW_TOOLS + 2 * n_tools),
    )


@intrinsic
def fence(typing_context):  # type: ignore[no-untyped-def]
    """Keep loads and stores on their side of this line, in the compiler and the processor."""

    def generate(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
        builder.fence("seq_cst")
        return context.get_dummy_value()

    return types.void(), generate


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


@kernel
def is_whole(sequences: Any, index: int, sequence_read: int) -> bool:
    """True when the slot that was just copied can't have been written over meanwhile."""
    fence()
    return sequences[index] - sequence_read < IN_SLOTS - 1


@kernel
def take_inputs(model: Any, state: Any, settings: Any, box: Any, row: Any) -> bool:
    """Take up what is new in the mailboxes; row (ROW_TOOLS + 2 T) becomes this tick's journal row.

    Returns True when anything was new.
    """
    changed = False
    if box.control[RESETS] != row[ROW_RESETS]:
        row[ROW_RESETS] = box.control[RESETS]
        reset_state(model, state)
        changed = True
    while box.settings_sequence[0] != row[ROW_SETTINGS]:
        sequence = box.settings_sequence[0]
        fence()
        copy(box.settings[sequence % IN_SLOTS], settings)
        changed = True
        if is_whole(box.settings_sequence, 0, sequence):
            row[ROW_SETTINGS] = sequence
            break
    for tool in range(len(box.pose_sequence)):
        column = ROW_TOOLS + 2 * tool
        while box.pose_sequence[tool] != row[column]:
            sequence = box.pose_sequence[tool]
            fence()
            copy(box.pose[sequence % IN_SLOTS, tool], box.taken_pose[tool])
            changed = True
            if is_whole(box.pose_sequence, tool, sequence):
                row[column] = sequence
                take_pose(state, tool, box.taken_pose[tool], sequence)
                break
        column += 1
        while box.force_sequence[tool] != row[column]:
            sequence = box.force_sequence[tool]
            fence()
            take_force(state, tool, box.force[sequence % IN_SLOTS, tool], sequence)
            changed = True
            if is_whole(box.force_sequence, tool, sequence):
                row[column] = sequence
                break
    while box.contact_sequence[0] != row[ROW_CONTACTS]:
        sequence = box.contact_sequence[0]
        fence()
        slot = sequence % IN_SLOTS
        take_contacts(
            state,
            box.contact_entries[slot],
            box.contact_tool[slot],
            box.contact_node[slot],
            box.contact_weight[slot],
            box.contact_normal[slot],
            box.tip_node[slot],
            box.tip_weight[slot],
            box.engaged[slot],
            sequence,
        )
        changed = True
        if is_whole(box.contact_sequence, 0, sequence):
            row[ROW_CONTACTS] = sequence
            break
    return changed


@kernel
def post_results(world: Any, box: Any, moved: bool) -> None:
    """Hand out wrenches and counters, and the positions when they moved: with a modal region, when asked."""
    state = world.state
    slot = (box.out_sequence[0] + 1) % OUT_SLOTS
    copy(state.wrench, box.out_wrench[slot])
    copy(state.count, box.out_count[slot])
    copy(state.tool_count, box.out_tool_count[slot])
    fence()
    box.out_sequence[0] += 1
    lazy = state.count[REGION] == MODAL and state.count[ASLEEP] == 0
    box.control[ON_DEMAND] = 1 if lazy else 0
    asked = box.control[SURFACE_ASKED]
    if lazy and asked != box.control[SURFACE_DONE]:
        place_outside(world.model, state, world.settings, world.scratch)
        lazy, moved = False, True
    if moved and not lazy:
        slot = (box.surface_sequence[0] + 1) % OUT_SLOTS
        copy(state.position, box.surface[slot])
        box.surface_tick[slot] = state.count[TICK]
        fence()
        box.surface_sequence[0] += 1
    fence()
    box.control[SURFACE_DONE] = asked


@kernel
def post_snapshot(box: Any, floats: Any, integers: Any) -> None:
    """Hand out the whole state when it was asked for."""
    control = box.control
    if control[SNAPSHOT_ASKED] != control[SNAPSHOT_DONE]:
        copy(floats, box.snapshot_floats)
        copy(integers, box.snapshot_integers)
        fence()
        control[SNAPSHOT_DONE] = control[SNAPSHOT_ASKED]


@kernel
def note_tick(box: Any, due: int, period: int, late: int, duration: int) -> None:
    """Note when a tick was due, its length, lateness and duration, ns."""
    control = box.control
    slot = control[LOOP_TICKS] % TIMING_ROWS
    box.timing[slot, 0] = late
    box.timing[slot, 1] = duration
    control[DUE] = due
    control[SIMULATED] += period
    control[LOOP_TICKS] += 1
    fence()


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
