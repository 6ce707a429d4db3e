"""A short soak with a real node: the shape comes back, and the bag holds all of it."""

import json

import numpy as np
import pytest

from tissue_sim.bench.soak import MOST_DRIFT, memory_of
from tissue_sim.cli import main
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
