"""A short soak with a real node: the shape comes back, and the bag holds all of it."""

import json

import numpy as np
import pytest

from tissue_sim.bench.soak import MOST_DRIFT, Soaked, as_json, memory_of
from tissue_sim.bench.soak_bag import BagFound
from tissue_sim.cli import main
from tissue_sim.ros.probes.soak_monitor import Sample
from tissue_sim.ros.shared.priority import is_allowed
from tissue_sim.ros.shared.report import STARVED


@pytest.mark.extended
def test_organ_comes_back_and_the_bag_is_whole(tmp_path):
    out = tmp_path / "soak.json"
    priority = 20 if is_allowed(20) else 0
    words = ["--minutes", "0.15", "--replay", "--json", str(out), "--realtime-priority", str(priority)]
    assert main(["bench", "soak", *words]) == 0
    found = json.loads(out.read_text())
    assert found["realtime_priority"] == priority
    assert 0.0 <= found["drift_m"] < MOST_DRIFT
    assert found["bag"]["missing"] == found["bag"]["not_finite"] == 0
    assert found["bag"]["wrenches"] > 100
    assert 0.05 < found["bag"]["highest_force"] <= found["force_clamp_n"]
    assert found["repeats"] is True
    assert set(found["failures"]) <= {STARVED}, "a busy machine may starve it"


def test_growth_of_memory_is_that_between_the_second_and_the_last_minute():
    seconds = np.arange(601.0)
    steady = memory_of(seconds, 100.0 + 50.0 * (seconds < 40.0))
    assert steady["growth_mb"] == 0.0
    leaking = memory_of(seconds, 100.0 + 0.01 * seconds)
    assert leaking["slope_mb_per_hour"] == pytest.approx(36.0)
    assert leaking["growth_mb"] == pytest.approx(0.01 * (570.0 - 89.5), rel=0.02)
    assert memory_of(seconds[:100], np.ones(100))["growth_mb"] is None


def test_each_figure_has_its_bound():
    samples = [Sample(second, 100.0, 10.0, 1000 * second, 0, 50.0, 0) for second in range(400)]
    bag = BagFound(1000, 10, 0, 0, 2.0, 5, 5)
    turns = [(4.0, np.zeros(4000))]
    good = Soaked("kidney", 6.0, 0, samples, turns, 1e-8, 3.3, bag, {}, [], True)

    def missed(**changed):
        return [bound["name"] for bound in as_json(good._replace(**changed))["bounds"] if not bound["met"]]

    assert missed() == []
    assert missed(drift=1e-3) == ["drift of the rest shape"]
    assert missed(clamp=1.0) == ["highest force"]
    assert missed(bag=bag._replace(missing=1)) == ["messages missing from the bag"]
    assert missed(problems={"faults": 2}) == ["problems in the diagnostics"]
    assert missed(repeats=False) == ["deviation of the replay"]
    late = [one._replace(late=10 * one.ticks // 1000) for one in samples]
    assert missed(samples=late) == ["ticks late by more than a period"]
    assert missed(samples=[one._replace(megabytes=100.0 + 0.1 * one.seconds) for one in samples]) == [
        "growth of the node's own memory"
    ]
