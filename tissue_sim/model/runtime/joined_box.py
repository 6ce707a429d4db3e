"""Inputs and outputs of all organs together, besides the mailboxes of each: contact pairs, breath, haptic output."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tissue_sim.array_types import Floats, Longs
from tissue_sim.jit import kernel
from tissue_sim.model.contact.haptic_output import sum_haptic_output
from tissue_sim.model.data.records import Record, Records
from tissue_sim.model.data.world import World
from tissue_sim.model.runtime.mailboxes import JOURNAL_ROWS, Mailbox, fence, mailbox, put, take
from tissue_sim.model.stepping.breathing import Breath
from tissue_sim.model.stepping.contact_pairs import (
    MAX_ORGANS,
    MAX_PAIRS,
    OrganContactSet,
    copy_pair,
    copy_points,
    organ_contact_set,
    separate_points,
    take_pairs,
)
from tissue_sim.model.stepping.coupled_step import CoupledOrgans


class JoinedRow(Record):
    """Sequence numbers of inputs to several organs that a tick applied."""

    tick: int
    pairs: int
    respiration: int


class JoinedSnapshot(NamedTuple):
    """Snapshot of the changing state of everything that joins organs, after a tick."""

    breath: Longs  # the words of a Breath
    pairs: OrganContactSet
    pressed: Floats  # (p,) N, as in OrganContacts
    held: Floats  # (p, 3) N
    version: Longs  # (MAX_ORGANS,) as in OrganContacts


class JoinedBox(NamedTuple):
    """Mailboxes of all organs. T rigid bodies."""

    pairs: Mailbox  # the words of pairs, the number of cut points, and these
    respiration: Mailbox  # (1,) a fraction of the breath's displacement
    wrenches: Mailbox  # wrench_words
    row: JoinedRow  # as the last tick took it up
    journal_written: Longs  # (1,)
    journal: Records  # (JOURNAL_ROWS,) of JoinedRow
    snapshot: JoinedSnapshot  # when asked
    # Used by the loop only.
    taken: OrganContactSet
    taken_fraction: Floats  # (1,)
    wrench_words: Longs  # (1 + 6 T,) the tick, and the wrench
    wrench: Floats  # (T, 6) N, N m, which views them


def make_joined_box(n_bodies: int) -> JoinedBox:
    """Return empty mailboxes for joined organs.

    Parameters
    ----------
    n_bodies : int
        Number of bodies.
    """
    taken, words = organ_contact_set(), np.zeros(1 + 6 * n_bodies, dtype=np.int64)
    return JoinedBox(
        pairs=mailbox(len(taken.words)),
        respiration=mailbox(1),
        wrenches=mailbox(len(words)),
        row=JoinedRow.new(),
        journal_written=np.zeros(1, dtype=np.int64),
        journal=JoinedRow.rows(np.zeros(JOURNAL_ROWS * JoinedRow.words(), dtype=np.int64)),
        snapshot=JoinedSnapshot(
            np.zeros(Breath.words(), dtype=np.int64),
            organ_contact_set(),
            np.zeros(MAX_PAIRS),
            np.zeros((MAX_PAIRS, 3)),
            np.zeros(MAX_ORGANS, dtype=np.int64),
        ),
        taken=taken,
        taken_fraction=np.zeros(1),
        wrench_words=words,
        wrench=words[1:].view(np.float64).reshape(n_bodies, 6),
    )


@kernel
def take_joined(joined: CoupledOrgans, box: JoinedBox, tick: int) -> None:
    """Apply new pairs and the breath's external input, and record the tick in the journal.

    Parameters
    ----------
    joined : CoupledOrgans
        What joins the organs; updated.
    box : JoinedBox
        Mailboxes of the joined organs; updated.
    tick : int
        Number of the tick.
    """
    row, changed = box.row, False
    sequence = take(box.respiration, 0, row.respiration, box.taken_fraction.view(np.int64))
    if sequence != row.respiration:
        row.respiration, changed = sequence, True
        joined.carried.breath.target = box.taken_fraction[0]
    sequence = take(box.pairs, 0, row.pairs, box.taken.words)
    if sequence != row.pairs:
        row.pairs, changed = sequence, True
        separate_points(box.taken)
        take_pairs(joined.pairs, box.taken)
    if changed:
        note_joined(box, tick)


@kernel
def note_joined(box: JoinedBox, tick: int) -> None:
    """Record in the journal which inputs this tick has applied."""
    box.row.tick = tick
    box.journal[box.journal_written[0] % JOURNAL_ROWS] = box.row
    fence()
    box.journal_written[0] += 1
    fence()


@kernel
def post_haptic_output(worlds: Sequence[World], joined: CoupledOrgans | None, box: JoinedBox) -> None:
    """Post the haptic output of all organs; that of a single organ is already clamped, and is posted unchanged."""
    box.wrench_words[0] = worlds[0].state.status.tick
    if joined is None:
        for body in range(len(box.wrench)):
            for axis in range(6):
                box.wrench[body, axis] = worlds[0].state.wrench[body, axis]
    else:
        sum_haptic_output(worlds, box.wrench)
    put(box.wrenches, 0, box.wrench_words)


@kernel
def snapshot_joined(joined: CoupledOrgans, box: JoinedBox, tick: int) -> None:
    """Copy the state of everything that joins organs; the journal shows which inputs it contains.

    Parameters
    ----------
    joined : CoupledOrgans
        What joins the organs.
    box : JoinedBox
        Mailboxes of the joined organs; updated.
    tick : int
        Number of the tick.
    """
    note_joined(box, tick)
    pairs, snapshot, words = joined.pairs, box.snapshot, joined.carried.breath_words
    for index in range(len(words)):
        snapshot.breath[index] = words[index]
    copy_points(pairs, snapshot.pairs)
    for organ in range(len(snapshot.version)):
        snapshot.version[organ] = pairs.version[organ]
    snapshot.pairs.found[0] = pairs.found[0]
    for pair in range(pairs.found[0]):
        copy_pair(pairs, pair, snapshot.pairs, pair)
        snapshot.pressed[pair] = pairs.pressed[pair]
        for axis in range(3):
            snapshot.held[pair, axis] = pairs.held[pair, axis]
