"""A journal that says what no recording does is refused before a replay follows it."""

import numpy as np
import pytest

from helpers.paths import ROOT
from tissue_sim.ros.bags.journal import LONGEST_STILL, check_journal
from tissue_sim.ros.bags.recording import Recording

RATE = 1000.0


@pytest.fixture(scope="module")
def recording():
    return Recording.read(ROOT / "bags" / "sleep")


def check(recording, **changed):
    check_journal({**recording.organs[0].journal, **changed}, 1, recording.first_tick, RATE)


def with_tick(rows, tick, at=3):
    rows = rows.copy()
    rows["tick"][at] = tick
    return rows


def test_a_journal_as_it_is_recorded_passes(recording):
    check(recording)
    check(recording, wrenches=with_tick(recording.organs[0].journal["wrenches"], -1))


@pytest.mark.parametrize("kind", ["inputs", "contacts", "wrenches", "surfaces", "body_inputs", "body_contacts"])
def test_rows_that_are_missing_or_of_another_kind_are_named(recording, kind):
    rows = recording.organs[0].journal[kind]
    without = {name: found for name, found in recording.organs[0].journal.items() if name != kind}
    with pytest.raises(ValueError, match=f"its journal has no {kind}"):
        check_journal(without, 1, recording.first_tick, RATE)
    *others, last = rows.dtype.names
    fewer = np.zeros(rows.shape, dtype=[*((name, rows.dtype[name]) for name in others), ("more", "i8")])
    strange = [(np.zeros(rows.shape), "have no field"), (fewer, f"have no field '{last}'")]
    texts = np.zeros(rows.shape, dtype=[(name, "U3") for name in rows.dtype.names])
    wide = np.zeros(rows.shape, dtype=[(name, "i8", (2,)) for name in rows.dtype.names])
    strange += [(texts, "of another type"), (wide, "of another type"), (rows.reshape(-1)[0], "have shape")]
    for found, reason in strange:
        with pytest.raises(ValueError, match=rf"its journal's ({kind}|body_{kind}) .*({reason}|have shape)"):
            check(recording, **{kind: found})


@pytest.mark.parametrize(("kind", "owner"), [("body_inputs", "inputs"), ("body_contacts", "contacts")])
def test_unequal_lengths_are_named(recording, kind, owner):
    rows = recording.organs[0].journal[kind]
    for found in (rows[:-2], np.concatenate([rows, rows[:1]]), np.repeat(rows, 2, axis=1)):
        with pytest.raises(ValueError, match=f"its journal's {kind} have shape"):
            check(recording, **{kind: found})
    with pytest.raises(ValueError, match=f"its journal's {kind} have shape"):
        check(recording, **{owner: recording.organs[0].journal[owner][:-2]})


@pytest.mark.parametrize("kind", ["inputs", "wrenches", "surfaces"])
def test_ticks_that_nobody_waits_for_are_refused(recording, kind):
    rows = recording.organs[0].journal[kind]
    for tick in (2**31, 2**40, 10**9):
        with pytest.raises(ValueError, match=r"no event for [\d.e+]+ hours"):
            check(recording, **{kind: with_tick(rows, tick)})
    for tick in (2**63 - 1, -2, -(2**63)):
        with pytest.raises(ValueError, match=f"contains tick {tick}"):
            check(recording, **{kind: with_tick(rows, tick)})
    check(recording, **{kind: with_tick(rows, recording.last_tick + int(LONGEST_STILL * RATE) - 10)})


@pytest.mark.parametrize("rate", [0.0, np.nan, 1e-9])
def test_a_rate_that_is_none_is_refused(recording, rate):
    with pytest.raises((ValueError, ArithmeticError)), np.errstate(all="ignore"):
        check_journal(recording.organs[0].journal, 1, recording.first_tick, rate)


@pytest.mark.parametrize("margin", [np.nan, np.inf, 1e300])
def test_a_margin_that_is_not_finite_is_refused(recording, margin):
    rows = recording.organs[0].journal["body_contacts"].copy()
    rows["margin"][0] = margin
    with pytest.raises(ValueError, match="'margin' that is not finite"):
        check(recording, body_contacts=rows)
