"""Ticks of a node around a cut: what the bounds say, and that a delay in a real one shows."""

import json
import sys

import numpy as np
import pytest

from helpers.ros.processes import HERE
from tissue_sim.bench.cutting import node_times
from tissue_sim.bench.cutting.cuts import CUTS
from tissue_sim.bench.cutting.node_times import CutInNode, as_json, text


def window(longest=2e-4, p99=1e-4, delays=(3e-4, 4e-4), late=3):
    """A window of two reports, after one that ends before it."""
    pytest.importorskip("rclpy")
    from tissue_sim.ros.probes.cut_probe import Window
    from tissue_sim.ros.probes.poke_probe import NodeReport

    def report(second, late, longest, p99):
        return NodeReport(second, 1000 * second, late, 0, 1.0, 6e-5, "none", p99, 1e-4, longest, 5e-4, 2)

    reports = [report(1, 0, 1.0, 1.0), report(2, 0, longest, 9e-5), report(3, late, 1e-4, p99)]
    return Window(np.array(delays), reports, "10 mm^2 cut", 0.4)


def test_bounds_take_the_worst_around_cuts_and_nothing_from_before_them():
    quick, slow = CutInNode(CUTS[0], window(longest=0.5), window()), CutInNode(CUTS[1], window(), window(2e-3, 3e-4))
    found = as_json([quick, slow])
    assert [(bound["value"], bound["met"]) for bound in found["bounds"]] == [
        (pytest.approx(2000.0), False),
        (pytest.approx(300.0), False),
    ]
    assert [bound["met"] for bound in as_json([quick])["bounds"]] == [True, True]
    assert found["rows"][0]["around_late"] == 3
    assert found["rows"][0]["around_ticks"] == 2000
    assert found["rows"][0]["around_delay_us"][2] == pytest.approx(400.0)
    assert json.loads(json.dumps(found)) == found
    lines = text(found)
    assert sum("around" in line for line in lines) == 2


def test_without_rclpy_it_says_so_and_measures_nothing():
    found = as_json([])
    assert [bound["met"] for bound in found["bounds"]] == [None, None]
    assert "rclpy is not installed" in "\n".join(text(found))


@pytest.mark.extended
@pytest.mark.timeout(600)
def test_a_delay_in_a_real_node_shows(monkeypatch):
    pytest.importorskip("rclpy")

    def served_by(graph, *parameters):
        words = [word for parameter in parameters for word in ("-p", parameter)]
        command = [sys.executable, str(HERE / "slow_cut_node.py"), "--ros-args", *words]
        return graph._begin("slow node", command)

    monkeypatch.setattr(node_times, "served_by", served_by)
    monkeypatch.setattr(node_times, "CUTS", CUTS[:1])
    monkeypatch.setattr(node_times, "UNDISTURBED", 0.1)
    monkeypatch.setattr(node_times, "WARMING_UP", 0.1)
    (row,) = as_json(node_times.measure())["rows"]
    assert "cells divided" in row["answer"]
    assert row["around_longest_us"] > 2000.0, "no processor copies five words in a nanosecond"
    assert row["around_delay_us"][2] > 4e4
    assert row["around_ticks"] > 1000
