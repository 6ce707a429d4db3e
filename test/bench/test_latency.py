"""The latency benchmark: its bare loop, its bounds, and one short run with real processes."""

import json
import os
import sys
from pathlib import Path

import numpy as np
import pytest

from tissue_sim.bench import arguments, latency_busy
from tissue_sim.bench.bare_loop import bare
from tissue_sim.bench.latency import RATES, WOKEN, as_json, measure, names, wrench_row_name
from tissue_sim.bench.latency_busy import AFTER, BUSY, PHASES, QUIET
from tissue_sim.cli import main
from tissue_sim.ros.probes.graph import Graph
from tissue_sim.ros.probes.poke_probe import DEPTH, NodeReport, PokeFigures, depth_after
from tissue_sim.ros.probes.probe import Trip, first_change, together
from tissue_sim.ros.shared.priority import is_allowed

DELAYED_NODE = Path(__file__).parents[1] / "helpers" / "ros" / "delayed_node.py"


def test_bare_loop_sleeps_to_its_deadlines_and_is_busy_in_between():
    late = bare(0.1, 2e-4)
    assert late.shape == (100,)
    assert np.all(late >= 0.0)


def test_a_bare_loop_with_a_priority_leaves_its_caller_as_it_was():
    if not is_allowed(20):
        pytest.skip("this user is not allowed to use a real-time priority")
    before = os.sched_getscheduler(0)
    bare(0.01, 0.0, 20)
    assert os.sched_getscheduler(0) == before


def trip(seconds, lost=0):
    return Trip(np.full(500, seconds), lost)


def test_bounds_are_on_delays_and_on_the_bare_loop():
    both = together([trip(1e-3, 1), trip(1e-3, 2)])
    assert (len(both.seconds), both.lost) == (1000, 3)

    def bounds(node, napping, late):
        trips = {name: node if name.startswith("wrench") else trip(2e-4) for name in names()} | {WOKEN[0]: napping}
        percentiles = {name: one.as_json() for name, one in trips.items()}
        return as_json(1.0, percentiles, (1000.0, late), np.r_[np.zeros(990), np.full(10, 2e-3)], 100.0)["bounds"]

    *delays, woken, late = bounds(trip(4e-4), trip(1e-3), 10.0)
    assert [bound["limit"] for bound in delays] == [450.0, 1000.0, 450.0, 1000.0, 600.0, 600.0]
    assert woken["limit"] == pytest.approx(1.5 * 200.0 + 1000.0)
    assert all(bound["met"] for bound in (*delays, woken, late))
    assert late["value"] == pytest.approx(1.0)
    assert late["limit"] == pytest.approx(2.0 * 1.0 + 0.2)
    assert not any(bound["met"] for bound in bounds(trip(0.01), trip(0.01), 500.0))


# the answer to a pose --------------------------------------------------------------------------
TICK, SENT = 1e-3, 0.1205  # s


def wrenches(computed, delay=0, noise=1e-4):
    """Wrenches every tick, s and N: 0.3 N, and from a tick on 0.03 N more, which comes in five of them."""
    rng, delays = np.random.default_rng(3), []
    for tick in range(220):
        risen = np.clip((tick - computed - delay + 1) / 5.0, 0.0, 1.0)
        delays.append((TICK * tick + 2e-4, np.array([0.3 + 0.03 * risen, 0.0, 0.0]) + noise * rng.standard_normal(3)))
    return delays


def test_what_is_timed_is_the_first_wrench_that_was_computed_with_the_pose():
    assert first_change(SENT, wrenches(121)) == pytest.approx(0.0007)


@pytest.mark.parametrize("ticks", [1, 2, 7])
def test_a_delay_of_ticks_shows(ticks):
    """Wrenches that come in between and say nothing of the pose do not count."""
    assert first_change(SENT, wrenches(121, ticks)) == pytest.approx(0.0007 + ticks * TICK)


def test_a_pose_without_an_answer_has_no_delay():
    assert first_change(SENT, wrenches(1000)) is None
    assert first_change(SENT, []) is None
    assert first_change(SENT, wrenches(121)[:50]) is None


@pytest.mark.extended
def test_short_run_with_real_processes(tmp_path):
    file = tmp_path / "latency.json"
    assert main(["bench", "latency", "--seconds", "2", "--json", str(file)]) == 0
    found = json.loads(file.read_text())
    assert set(found["round_trips"]) == set(names())
    assert all(one["trips"] > 0 for one in found["round_trips"].values())
    assert found["late"]["ticks"] > 0


@pytest.mark.extended
def test_a_delay_that_is_planted_in_the_node_shows_at_every_rate(monkeypatch):
    def serve(graph, *parameters, within=(), environment=None):
        words = [word for parameter in parameters for word in ("-p", parameter)]
        command = [sys.executable, str(DELAYED_NODE), "--ros-args", *words]
        return graph._begin("program", [*within, *command], {**os.environ, "DELAYED_TICKS": "20"})

    monkeypatch.setattr(Graph, "serve", serve)
    trips = measure(None, 4.0)["round_trips"]
    for rate in RATES:
        delays = trips[wrench_row_name(rate)]
        assert delays["p50_us"] >= 19_000.0
        assert delays["lost"] < delays["trips"], "those that are lost count as later still"


def test_seconds_out_of_range_are_refused(capsys):
    assert main(["bench", "latency", "--seconds", "0"]) == 2
    assert "--seconds" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["latency", "soak"])
def test_a_priority_out_of_range_is_refused(name, capsys):
    assert main(["bench", name, "--realtime-priority", "100"]) == 2
    assert "--realtime-priority 100 is outside 0..99" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["latency", "soak"])
def test_a_priority_that_is_not_allowed_is_refused_in_one_line(name, monkeypatch, capsys):
    monkeypatch.setattr(arguments, "is_allowed", lambda _: False)
    assert main(["bench", name, "--realtime-priority", "20"]) == 2
    error = capsys.readouterr().err
    assert "real-time priority 20" in error
    assert error.count("\n") == 1


def report_of(seconds, tick, late=0, dropped=0, pace=1.0, degraded="none"):
    return NodeReport(seconds, tick, late, dropped, pace, 1e-4, degraded)


def test_a_hand_comes_from_outside_and_is_deepest_in_the_middle_of_a_poke():
    assert [depth_after(seconds) for seconds in (0.0, 0.25, 0.5, 1.0)] == pytest.approx([-DEPTH, 0.0, DEPTH, -DEPTH])


def test_a_phase_is_what_the_node_did_between_its_first_report_and_its_last():
    reports = [
        report_of(10.0, 5000, 7, 2),
        report_of(11.0, 5900, 17, 52, 0.95, "markers"),
        report_of(13.0, 7700, 26, 52, 0.8),
    ]
    phase = latency_busy.phase_json(PokeFigures(np.array([0.2, 0.3]), 0.004, reports), 1.5)
    assert phase["ticks_per_second"] == pytest.approx(900.0)
    assert phase["late_percent"] == pytest.approx(100.0 * 19 / 2700)
    assert phase["dropped"] == 50
    assert phase["simulated_fraction"] == pytest.approx((0.95 + 2 * 0.8) / 3.0)
    assert (phase["degraded"], phase["longest_gap_ms"], phase["bare_late_percent"]) == (["markers"], 4.0, 1.5)


def busy_bounds(priority, *, peaks=(0.2, 0.2), rate=1000.0, late=0.0, back=0.0):
    def phase(name):
        hit = name == BUSY
        ticks = [
            report_of(0.0, 0),
            report_of(10.0, round(10.0 * (rate if hit else 1000.0)), round(late if hit else 0.0)),
        ]
        return latency_busy.phase_json(PokeFigures(np.array(peaks if hit else (0.2, 0.2)), 0.0, ticks), 0.0)

    nodes = [
        {"realtime_priority": priority, "seconds_until_back": back, "phases": {name: phase(name) for name in PHASES}}
    ]
    found = latency_busy.as_json(10.0, 20, nodes)
    assert latency_busy.text(found)
    return {bound["name"].partition(": ")[2]: bound["met"] for bound in found["bounds"]}


def test_bounds_beside_busy_programs():
    assert all(busy_bounds(20).values())
    assert busy_bounds(20, peaks=(0.2, 0.225))["worst poke, busy"] is False
    assert busy_bounds(0, peaks=(0.175, 0.2))["worst poke, busy"] is False
    assert busy_bounds(20, rate=980.0)["missing ticks, busy"] is False
    assert busy_bounds(20, late=100.0)["late ticks, busy"] is False
    assert busy_bounds(20, back=91.0)["until no longer degraded"] is False
    assert busy_bounds(0, rate=500.0, late=900.0)["missing ticks, busy"] is None  # that of the priority: not measured


@pytest.mark.extended
def test_short_run_beside_busy_programs(tmp_path, monkeypatch):
    monkeypatch.setattr(latency_busy, "LONGEST_BACK", 2.0)  # s; beside other tests it may take long to come back
    file = tmp_path / "busy.json"
    assert main(["bench", "latency", "--busy", "--seconds", "4", "--json", str(file)]) == 0
    found = json.loads(file.read_text())
    assert [node["realtime_priority"] for node in found["nodes"]] == [0, 20][: 1 + is_allowed(20)]
    for node in found["nodes"]:
        assert len(node["phases"][QUIET]["peaks_n"]) == 4
        assert np.median(node["phases"][QUIET]["peaks_n"]) > 0.05
        assert node["phases"][AFTER]["ticks_per_second"] > 0.0


def test_too_short_a_time_beside_busy_programs_is_refused(capsys):
    assert main(["bench", "latency", "--busy", "--seconds", "2"]) == 2
    assert "--seconds 2 with --busy" in capsys.readouterr().err
