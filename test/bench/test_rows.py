"""Rows as they come, and what Ctrl-C leaves of a benchmark."""

import importlib
import json
from pathlib import Path

import numpy as np
import pytest

from tissue_sim.bench import command, fall, haptics, latency_busy, pinch, pinch_reference, region, rows, start
from tissue_sim.bench import scaling as growth
from tissue_sim.bench.printing import Bound, bound_lines
from tissue_sim.bench.timing import Phase, interleave
from tissue_sim.cli import main


@pytest.fixture(autouse=True)
def no_rows():
    rows.begin()
    yield
    rows.begin()


def interrupted(*_):
    raise KeyboardInterrupt


def test_what_was_measured_stays_and_what_follows_has_nothing_to_do(capsys):
    found = []
    with rows.until_stopped():
        for one in rows.each(range(5), "loads"):
            if one == 2:
                interrupted()
            found.append(one)
            rows.report(f"load {one}", "3 %", "4 N")
    assert (found, rows.stopped()) == ([0, 1], True)
    assert list(rows.each(range(5), "other loads")) == []
    captured = capsys.readouterr()
    assert (captured.out, captured.err) == ("", "load 0: 3 %, 4 N\nload 1: 3 %, 4 N\n")


def test_where_nothing_was_measured_it_is_an_interrupt(monkeypatch, capsys):
    monkeypatch.setattr(fall, "in_one_thread", interrupted)
    assert main(["bench", "fall"]) == 130
    captured = capsys.readouterr()
    assert (captured.out, captured.err) == ("", "tissue_sim bench fall: stopped; there is no result\n")


FALLEN = fall.SuddenLoad(0.2, "bump", 0.1, 1e-3, 0.001, True, 0, 0.9, 0)


def stopped_early(*_):
    rows.keep()
    rows.stop()
    return [FALLEN]


def test_json_says_that_it_was_stopped_and_is_alone_on_the_standard_output(monkeypatch, capsys):
    monkeypatch.setattr(fall, "in_one_thread", stopped_early)
    assert main(["bench", "fall", "--check", "--json", "-"]) == 130
    found = json.loads(capsys.readouterr().out)
    assert found["stopped"] is True
    assert len(found["loads"]) == 1


def test_a_run_after_one_that_was_stopped_is_whole(monkeypatch, capsys):
    monkeypatch.setattr(fall, "in_one_thread", stopped_early)
    assert main(["bench", "fall"]) == 130
    assert "stopped" in capsys.readouterr().out
    monkeypatch.setattr(fall, "in_one_thread", lambda *_: [FALLEN])
    assert main(["bench", "fall", "--check"]) == 0
    assert "stopped" not in capsys.readouterr().out


def test_a_bound_that_holds_so_far_is_not_held_and_one_that_is_missed_stays_missed():
    bounds = [Bound("good", 1.0, 2.0, "mm"), Bound("bad", 3.0, 2.0, "mm"), Bound("none", None, 2.0, "mm")]
    assert [one.met for one in bounds] == [True, False, None]
    rows.stop()
    assert [one.met for one in bounds] == [None, False, None]
    lines = bound_lines([one.as_json() for one in bounds])
    assert [line.split("  ")[-1] for line in lines[2:]] == ["met so far", "missed", "not measured"]


# what is measured in turns ---------------------------------------------------------------------------


def bursts(after, name="one"):
    """Two pieces of work, of which one is interrupted after so many bursts."""
    count = {name: 0}

    def burst(samples):
        count[name] += 1
        if count[name] > after:
            interrupted()
        return np.full(samples, 0.01)

    return {name: burst, "other": lambda samples: np.full(samples, 0.02)}


def test_turns_that_are_interrupted_leave_all_that_was_sampled(capsys):
    found = interleave(Phase(bursts(3), 1.0, "ticks"))
    assert rows.stopped()
    assert found["one"].median == pytest.approx(0.01)
    assert 0 < found["one"].samples < 100
    assert set(found) == {"one", "other"}
    assert capsys.readouterr().err.splitlines() == ["one: first pass 1e+04 us", "other: first pass 2e+04 us"]


def test_turns_that_have_just_begun_leave_the_first_look():
    found = interleave(Phase(bursts(1), 1.0, "ticks"))
    assert {name: one.samples for name, one in found.items()} == {"one": 2, "other": 2}


def test_turns_before_whose_first_look_it_comes_leave_nothing():
    with pytest.raises(KeyboardInterrupt):
        interleave(Phase(bursts(0), 1.0, "ticks"))
    rows.keep()
    assert interleave(Phase(bursts(0), 1.0, "growth")) == {}


# every benchmark -------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", command.BENCHMARKS)
def test_every_benchmark_tells_rows_and_keeps_them(name):
    """Those that measure once have no rows: their progress is all there is to tell."""
    module = importlib.import_module(command.BENCHMARKS[name][0])
    # That of a folder is the command alone: what it measures lies in files beside it.
    own = Path(module.__file__)
    files = [own] if own.parent.name == "bench" else own.parent.glob("*.py")
    source = "".join(path.read_text() for path in files)
    assert ("until_stopped" in source or "interleave" in source) != (name == "page")


def test_figures_of_few_rows():
    """What was stopped early has no figure for its bounds, and is printed all the same."""
    rows.stop()
    assert growth.as_json([])["substep_exponent"] is None
    empty = pinch.as_json([], np.full(10, 5e-5), pinch_reference.as_json([]))
    assert {bound["value"] for bound in empty["bounds"]} == {None}
    assert pinch.text(empty)
    found = haptics.as_json([], [])
    assert {bound["value"] for bound in found["bounds"]} == {None}
    assert haptics.text(found)
    one = region.PlaceErrors(3, 0.5, 3e-3, True, 1.0, 1.0, 1.0, False, None, 2.0)
    small, every, settled = region.as_json([one], [])["bounds"]
    assert (small["value"], every["value"], settled["value"]) == (None, 1.0, 100.0)


def test_a_start_without_its_node():
    measured = {"wall": 9.0, "processor": 8.0, "parts": {"imports": 1.0}, "compiled": {}}
    found = start.as_json({start.TO_COMPILE: measured}, {}, {}, "")
    assert found["bounds"][-1]["value"] is None
    assert "node, to its first tick" in start.text(found)


def test_a_node_whose_quiet_phase_alone_was_measured():
    phase = {
        "peaks_n": [0.2, 0.2],
        "longest_gap_ms": 4.0,
        "ticks_per_second": 1000.0,
        "late_percent": 0.0,
        "bare_late_percent": 0.0,
        "dropped": 0,
        "simulated_fraction": 1.0,
        "degraded": ["markers"],
    }
    node = {"realtime_priority": 0, "seconds_until_back": None, "phases": {latency_busy.QUIET: phase}}
    found = latency_busy.as_json(10.0, 20, [node])
    assert {bound["value"] for bound in found["bounds"]} == {None}
    assert "degraded: markers" in latency_busy.text(found)
