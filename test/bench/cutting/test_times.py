"""Times of cuts: what is timed, and what the bounds say."""

import json

import numpy as np
import pytest

from helpers.bars import bar
from tissue_sim.bench.cutting import times
from tissue_sim.bench.cutting.cuts import Cut

CUT = Cut("bar", "flat", 0.03, 0.012, (0.3, 0.05, 1.0), 90.0)


@pytest.fixture(scope="module")
def timed():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(times, "REPEATS", 1)
        patch.setattr(times, "TICKS", 200)
        return times.timed(bar(12, 0.01, 4), CUT)


def test_parts_are_within_the_whole_and_sizes_are_those_of_the_cut(timed):
    assert 0.0 < timed.topology < timed.total
    assert len(timed.before) == len(timed.after) == 200
    assert timed.cells[1] > timed.cells[0]
    assert timed.nodes[1] > timed.nodes[0]
    assert timed.critical_step[1] == pytest.approx(timed.critical_step[0], rel=0.05)


def test_bounds_take_the_worst(timed):
    slow = timed._replace(critical_step=(1e-3, 9e-4))
    found = times.as_json([timed, slow], np.full(10, 5e-5))
    value = {bound["name"]: (bound["value"], bound["met"]) for bound in found["bounds"]}
    assert value["critical step after a cut"] == (pytest.approx(90.0), False)
    assert json.loads(json.dumps(found)) == found
    lines = times.text(found)
    assert sum("bar, flat 30 x 12" in line for line in lines) == 4
