"""Mailboxes between the compiled loop and Python, in shared arrays.

A mailbox has a sequence number and a few slots: the writer fills slot `(sequence + 1) % slots` and then raises the
number; the reader copies slot `sequence % slots` and accepts it if the writer can't have reached it again meanwhile.
Neither side waits for the other. Messages are words, which writer and reader interpret.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numba import types
from numba.extending import intrinsic
from numpy.typing import NDArray

from tissue_sim.array_types import Floats, Longs
from tissue_sim.jit import kernel, short
from tissue_sim.model.cutting.carry import NO_PLAN, CarryPlan
from tissue_sim.model.data.contact_set import ContactSet, contact_set
from tissue_sim.model.data.records import Record, Records
from tissue_sim.model.data.settings import Settings
from tissue_sim.model.data.state import State
from tissue_sim.model.data.world import World
from tissue_sim.model.regions.active_region import is_outside_current, update_outside
from tissue_sim.model.stepping.inputs import reset_state, take_contacts, take_force, take_pose

SLOTS = 4
JOURNAL_ROWS = 8192
TIMING_ROWS = 8192
POSE_WORDS = 8
REPOST_DISTANCE = 5e-5  # m by which the breath moves a sleeping organ before its shape is posted again


class Mailbox(NamedTuple):
    """Newest messages for each of m addressees."""

    sequence: Longs  # (m,) of the newest one; 0 before the first
    length: Longs  # (m, SLOTS) words of each
    slots: Longs  # (m, SLOTS, most)


def mailbox(most: int, addressees: int = 1) -> Mailbox:
    """Return an empty mailbox.

    Parameters
    ----------
    most : int
        Largest number of words of a message.
    addressees : int, optional
        Number of addressees.
    """
    counts = np.zeros(addressees, dtype=np.int64), np.zeros((addressees, SLOTS), dtype=np.int64)
    return Mailbox(*counts, np.zeros((addressees, SLOTS, most), dtype=np.int64))


class Control(Record):
    """Words shared by the loop and Python, each written by one of them."""

    stop: bool
    started: bool  # the loop runs and has posted the rest shape
    napping: bool  # the loop sleeps for several ticks
    waiting: bool  # the loop sleeps until its next tick, which a pose makes start early
    asked: int  # raised after posting something urgent: all of a tool's bodies, to all organs
    sim_time: bool  # ticks follow posted_time, not the monotonic clock
    standing: bool  # /clock has given no time, or hasn't advanced for a while
    resets: int
    snapshot_asked: int
    snapshot_done: int
    loop_ticks: int
    overruns: int
    dropped: int
    simulated: int  # ns of simulated time
    due: int  # ns of the clock in use: when the last tick was due
    last_wait: int  # ns of the monotonic clock when the loop last began to wait; long ago if it hangs or starves
    posted_time: int  # ns, newest time of /clock; 0 before the first one


class Demand(Record):
    """Words about an organ's positions, shared by the loop and Python, each written by one of them."""

    on_demand: bool  # positions are posted only on request, because most of them are not computed
    moved: bool  # they have changed since they were posted
    asked: int
    done: int
    x: float  # m, displacement of the organ by the breath when they were posted
    y: float
    z: float


class RequestPhase(Record):
    """State of the loop about requests and posted times."""

    waits: int  # number of ticks in a row with one request, which had to wait until the tick was due
    shift: int  # ns by which the due times of ticks were shifted for the requests
    seen: int  # ns, newest posted time that the loop has seen
    seen_at: int  # ns of the monotonic clock, when it saw that time
    behind: int  # ns, remaining lag behind the previous posted time


class JournalRow(Record):
    """Sequence numbers of the inputs that a tick applied, where any was new."""

    tick: int
    contact_set: int
    settings: int
    resets: int


class BodyInputs(Record):
    """Sequence numbers of a rigid body's inputs that a tick applied."""

    pose: int
    force: int


class Timing(Record):
    """Timing of a tick."""

    late: int  # ns
    duration: int  # ns


class LoopWords(NamedTuple):
    """Inputs and outputs of a loop that don't belong to an organ."""

    control: Control
    timing: Records  # (TIMING_ROWS,) of Timing
    phase: RequestPhase
    now: Longs  # (2,) a timespec
    wake: Longs  # (2,) another
    bell: Longs  # (4,) a sem_t, posted to wake the loop
    answered: Longs  # (4,) another, posted by the loop after a requested tick


class Mailboxes(NamedTuple):
    """All inputs and outputs of an organ; T rigid bodies, n nodes."""

    pose: Mailbox  # to each body, (7,) floats and the stamp, ns
    force: Mailbox  # to each body, (3,) floats
    contacts: Mailbox  # ContactSet.words
    settings: Mailbox  # words of Settings
    results: Mailbox  # State.results, after every tick
    shape: Mailbox  # State.shape, after every tick with motion, or on request
    snapshot: Longs  # State.words, on request
    demand: Demand
    journal_written: Longs  # (1,)
    journal: Records  # (JOURNAL_ROWS,) of JournalRow
    journal_inputs: NDArray[np.record]  # (JOURNAL_ROWS, T) of BodyInputs
    row: JournalRow  # as applied by the last tick
    inputs: Records  # (T,) of BodyInputs, likewise
    # The loop's copies.
    taken_pose: Longs  # (8,) the words of 7 floats, and the stamp
    taken_force: Floats  # (3,)
    taken_contacts: ContactSet
    carry: CarryPlan  # how the state continues that of the mailboxes before, see exchange.py


def _longs(*shape: int) -> Longs:
    return np.zeros(shape, dtype=np.int64)


def make_loop_words() -> LoopWords:
    """Return the words of a loop that has not started."""
    return LoopWords(
        control=Control.new(),
        timing=Timing.rows(_longs(TIMING_ROWS * Timing.words())),
        phase=RequestPhase.new(),
        now=_longs(2),
        wake=_longs(2),
        bell=_longs(4),
        answered=_longs(4),
    )


def make_mailboxes(state: State) -> Mailboxes:
    """Return empty mailboxes for a simulation's state.

    Parameters
    ----------
    state : State
        The state.
    """
    n_bodies = len(state.body_pose)
    body_words = BodyInputs.words()
    return Mailboxes(
        pose=mailbox(POSE_WORDS, n_bodies),
        force=mailbox(3, n_bodies),
        contacts=mailbox(len(state.contacts.words)),
        settings=mailbox(Settings.words()),
        results=mailbox(len(state.results)),
        shape=mailbox(len(state.shape)),
        snapshot=_longs(len(state.words)),
        demand=Demand.new(),
        journal_written=_longs(1),
        journal=JournalRow.rows(_longs(JOURNAL_ROWS * JournalRow.words())),
        journal_inputs=BodyInputs.rows(_longs(JOURNAL_ROWS * n_bodies * body_words)).reshape(JOURNAL_ROWS, n_bodies),
        row=JournalRow.new(),
        inputs=BodyInputs.rows(_longs(n_bodies * body_words)),
        taken_pose=_longs(POSE_WORDS),
        taken_force=np.zeros(3),
        taken_contacts=contact_set(n_bodies),
        carry=NO_PLAN,
    )


@intrinsic
def fence(typing_context):  # type: ignore[no-untyped-def]
    """Memory barrier for the compiler and the processor: no load or store moves past it."""

    def generate(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
        builder.fence("seq_cst")
        return context.get_dummy_value()

    return types.void(), generate


@short
def put(box: Mailbox, addressee: int, message: Longs) -> int:
    """Post a message.

    Parameters
    ----------
    box : Mailbox
        The mailbox; updated.
    addressee : int
        Index of the addressee.
    message : Longs, shape (l,)
        Words.
    """
    sequence = box.sequence[addressee] + 1
    slot = sequence % SLOTS
    target = box.slots[addressee, slot]
    for index in range(len(message)):
        target[index] = message[index]
    box.length[addressee, slot] = len(message)
    fence()
    box.sequence[addressee] = sequence
    fence()
    return sequence


@short
def take(box: Mailbox, addressee: int, last: int, message: Longs) -> int:
    """Copy the newest message.

    Parameters
    ----------
    box : Mailbox
        The mailbox.
    addressee : int
        Index of the addressee.
    last : int
        Sequence number of the last one that was taken.
    message : Longs
        Receives the words.

    Returns
    -------
    int
        Its sequence number; `last` when none is newer.
    """
    while box.sequence[addressee] != last:
        sequence = box.sequence[addressee]
        fence()
        slot = sequence % SLOTS
        source = box.slots[addressee, slot]
        for index in range(min(box.length[addressee, slot], len(message))):
            message[index] = source[index]
        fence()
        if box.sequence[addressee] - sequence < SLOTS - 1:
            return sequence
    return last


@kernel
def take_inputs(world: World, box: Mailboxes, resets: int) -> None:
    """Apply new messages in the mailboxes, and a requested reset.

    box.row and box.inputs are written to the journal as this tick's, if any input was new.

    Parameters
    ----------
    world : World
        World of the organ; updated.
    box : Mailboxes
        Mailboxes of the organ; updated.
    resets : int
        Number of resets requested so far.
    """
    state, row, changed = world.state, box.row, False
    if resets != row.resets:
        row.resets = resets
        reset_state(world.model, state)
        box.demand.moved = changed = True
    sequence = take(box.settings, 0, row.settings, world.settings_words)
    if sequence != row.settings:
        row.settings, changed = sequence, True
    for body in range(len(box.inputs)):
        taken = box.inputs[body]
        sequence = take(box.pose, body, taken.pose, box.taken_pose)
        if sequence != taken.pose:
            taken.pose, changed = sequence, True
            pose, stamp = box.taken_pose[:7].view(np.float64), box.taken_pose[7]
            for axis in range(3):
                pose[axis] -= state.carried[axis]
            take_pose(world, body, pose, stamp, sequence)
        sequence = take(box.force, body, taken.force, box.taken_force.view(np.int64))
        if sequence != taken.force:
            taken.force, changed = sequence, True
            take_force(state, body, box.taken_force, sequence)
    sequence = take(box.contacts, 0, row.contact_set, box.taken_contacts.words)
    if sequence != row.contact_set:
        row.contact_set, changed = sequence, True
        take_contacts(state, world.shapes, box.taken_contacts, sequence)
    if changed:
        write_journal(box, state.status.tick + 1)


@kernel
def write_journal(box: Mailboxes, tick: int) -> None:
    """Record in the journal which inputs this tick has applied."""
    box.row.tick = tick
    place = box.journal_written[0] % JOURNAL_ROWS
    box.journal[place] = box.row
    for body in range(len(box.inputs)):
        box.journal_inputs[place, body] = box.inputs[body]
    fence()
    box.journal_written[0] += 1
    fence()


@kernel
def post_results(world: World, box: Mailboxes) -> None:
    """Post wrenches and counters, and the positions if they have changed; with a modal region only on request.

    Parameters
    ----------
    world : World
        World of the organ; updated.
    box : Mailboxes
        Mailboxes of the organ; updated.
    """
    state, demand = world.state, box.demand
    put(box.results, 0, state.results)
    if not state.status.asleep or continues_motion(state.carried, demand):
        demand.moved = True
    lazy = not is_outside_current(state)
    demand.on_demand = lazy
    asked = demand.asked
    if lazy and asked != demand.done:
        update_outside(world.model, state, world.settings, world.scratch)
        lazy, demand.moved = False, True
    if demand.moved and not lazy:
        state.shape_tick[0] = state.status.tick
        demand.x, demand.y, demand.z = state.carried[0], state.carried[1], state.carried[2]
        put(box.shape, 0, state.shape)
    demand.moved = False
    fence()
    demand.done = asked


@kernel
def continues_motion(carried: Floats, demand: Demand) -> bool:
    """Return whether the breath has moved an organ by more than REPOST_DISTANCE since its positions were posted."""
    x, y, z = carried[0] - demand.x, carried[1] - demand.y, carried[2] - demand.z
    return x * x + y * y + z * z > REPOST_DISTANCE * REPOST_DISTANCE


@kernel
def snapshot_states(worlds: Sequence[World], boxes: Sequence[Mailboxes]) -> None:
    """Copy the states of all organs; the journals show which inputs they contain.

    Parameters
    ----------
    worlds : Sequence[World]
        Worlds of the organs.
    boxes : Sequence[Mailboxes]
        Mailboxes of every organ; updated.
    """
    for organ in range(len(worlds)):
        state, box = worlds[organ].state, boxes[organ]
        write_journal(box, state.status.tick)
        for index in range(len(state.words)):
            box.snapshot[index] = state.words[index]


@kernel
def note_tick(loop: LoopWords, due: int, period: int, late: int, duration: int) -> None:
    """Record when a tick was due, and its timing.

    Parameters
    ----------
    loop : LoopWords
        Words of the loop; updated.
    due : int, ns
        When it was due.
    period : int, ns
        Its length.
    late : int, ns
        Its lateness.
    duration : int, ns
        Its duration.
    """
    control = loop.control
    timing = loop.timing[control.loop_ticks % TIMING_ROWS]
    timing.late, timing.duration = late, duration
    control.due = due
    control.simulated += period
    control.loop_ticks += 1
    fence()
