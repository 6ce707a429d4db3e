"""Mailboxes between the compiled loop and Python, in shared arrays.

A mailbox has a sequence number and a few slots: the writer fills slot `(sequence + 1) % slots` and then raises the
number; the reader copies slot `sequence % slots` and accepts it if the writer can't have come round to it meanwhile.
Nobody waits for anybody.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import types
from numba.extending import intrinsic

from tissue_sim.array_types import Floats, Longs
from tissue_sim.jit import kernel
from tissue_sim.model.arrays import copy
from tissue_sim.model.inputs import reset_state, take_contacts, take_force, take_pose
from tissue_sim.model.modal_region import place_outside
from tissue_sim.model.state import ASLEEP, MAX_ENTRIES, MODAL, N_COUNT, N_SETTINGS, REGION, TICK, StateBuffer

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

# Columns of Mailboxes.clock: two timespecs; the newest posted time that the loop has seen, when it saw that, and how
# far it still was from the one before.
SECONDS, NANOSECONDS, WAKE_SECONDS, WAKE_NANOSECONDS, SEEN, SEEN_AT, BEHIND = range(7)


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
