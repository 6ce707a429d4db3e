"""The latency benchmark: its bare loop, its bounds, and one short run with real processes."""

import json

import numpy as np
import pytest

from tissue_sim.bench import latency
from tissue_sim.bench.latency import TRIPS, as_json, bare
from tissue_sim.cli import main
from tissue_sim.ros.probes.probe import Trip, together


def test_bare_loop_sleeps_to_its_deadlines_and_is_busy_in_between():
    late = bare(0.1, 2e-4)
    assert late.shape == (100,)
    assert np.all(late >= 0.0)


def trip(seconds, lost=0):
    return Trip(np.full(500, seconds), lost)


def test_bounds_follow_from_the_echo_and_the_bare_loop():
    both = together([trip(1e-3, 1), trip(1e-3, 2)])
    assert (len(both.seconds), both.lost) == (1000, 3)

    def bounds(node, napping, late):
        trips = dict(zip(TRIPS, (node, trip(4e-4), napping, trip(2e-4)), strict=True))
        told = {name: one.as_json() for name, one in trips.items()}
        return as_json(1.0, told, (1000.0, late), np.r_[np.zeros(990), np.full(10, 2e-3)], 100.0)["bounds"]

    answered, woken, late = bounds(both, trip(1e-3), 10.0)
    assert answered["limit"] == pytest.approx(1.5 * 400.0 + 1000.0)
    assert woken["limit"] == pytest.approx(1.5 * 200.0 + 1000.0)
    assert answered["met"]
    assert woken["met"]
    assert late["value"] == pytest.approx(1.0)
    assert late["limit"] == pytest.approx(2.0 * 1.0 + 0.2)
    assert not any(bound["met"] for bound in bounds(trip(0.01), trip(0.01), 500.0))


def test_short_run_with_real_processes(tmp_path):
    file = tmp_path / "latency.json"
    assert main(["bench", "latency", "--seconds", "2", "--json", str(file)]) == 0
    found = json.loads(file.read_text())
    assert set(found["round_trips"]) == set(TRIPS)
    assert all(one["trips"] > 0 for one in found["round_trips"].values())
    assert found["late"]["ticks"] > 0


def test_seconds_out_of_range_are_refused(capsys):
    assert main(["bench", "latency", "--seconds", "0"]) == 2
    assert "--seconds" in capsys.readouterr().err


def test_a_priority_that_is_not_allowed_is_refused_in_one_line(monkeypatch, capsys):
    monkeypatch.setattr(latency, "is_allowed", lambda _: False)
    assert main(["bench", "latency", "--realtime-priority", "20"]) == 2
    error = capsys.readouterr().err
    assert "real-time priority 20" in error
    assert error.count("\n") == 1
