"""The latency benchmark: its bare loop, its bounds, and one short run with real processes."""

import json
import os

import numpy as np
import pytest

from tissue_sim.bench import latency
from tissue_sim.bench.latency import as_json, bare
from tissue_sim.cli import main
from tissue_sim.ros.latency.probe import Trip, together


def test_bare_loop_sleeps_to_its_deadlines_and_is_busy_in_between():
    late = bare(0.1, 2e-4)
    assert late.shape == (100,)
    assert np.all(late >= 0.0)


def test_bounds_follow_from_the_echo_and_the_bare_loop():
    trips = together([Trip(np.full(500, 1e-3), 1), Trip(np.full(500, 1e-3), 2)])
    assert (len(trips.seconds), trips.lost) == (1000, 3)
    echo = Trip(np.full(1000, 4e-4), 0)
    found = as_json(1.0, trips, echo, [1000.0], [10.0], np.r_[np.zeros(990), np.full(10, 2e-3)], 100.0)
    trip, late = found["bounds"]
    assert trip["limit"] == pytest.approx(1.5 * 400.0 + 1000.0)
    assert trip["met"]
    assert late["value"] == pytest.approx(1.0)
    assert late["limit"] == pytest.approx(2.0 * 1.0 + 0.2)
    slow = as_json(1.0, Trip(np.full(10, 0.01), 0), echo, [1000.0], [500.0], np.zeros(1000), 100.0)
    assert not any(bound["met"] for bound in slow["bounds"])


def test_short_run_with_real_processes(tmp_path, monkeypatch):
    monkeypatch.setattr(latency, "START_TIME", 100.0)
    for name in ("ROS_DOMAIN_ID", "ROS_AUTOMATIC_DISCOVERY_RANGE"):
        monkeypatch.setenv(name, os.environ[name])  # so that they are put back
    file = tmp_path / "latency.json"
    assert main(["bench", "latency", "--seconds", "1", "--json", str(file)]) == 0
    found = json.loads(file.read_text())
    assert found["round_trips"]["node"]["trips"] > 100
    assert found["round_trips"]["echo"]["trips"] > 100
    assert found["late"]["ticks"] > 300


def test_seconds_out_of_range_are_refused(capsys):
    assert main(["bench", "latency", "--seconds", "0"]) == 2
    assert "--seconds" in capsys.readouterr().err


def test_a_priority_that_is_not_allowed_is_refused_in_one_line(monkeypatch, capsys):
    monkeypatch.setattr(latency, "is_allowed", lambda _: False)
    assert main(["bench", "latency", "--realtime-priority", "20"]) == 2
    error = capsys.readouterr().err
    assert "real-time priority 20" in error
    assert error.count("\n") == 1
