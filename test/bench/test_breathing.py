"""An organ whose clamp breathes, against finite elements."""

import pytest

from helpers.scenes import ball_of_cells
from tissue_sim.bench.breathing import DISPLACEMENT, as_json, measure, text
from tissue_sim.model.stepping.wake_threshold import WAKE_DISPLACEMENT


@pytest.mark.extended
def test_a_slow_breath_carries_an_organ_as_finite_elements_go():
    organ = ball_of_cells(2, 120)
    found = measure(organ, (40.0, 120.0), {"along z": (0.0, 0.0, 1.0)})
    slow, fast = found
    assert slow.most_off < 0.01 * DISPLACEMENT
    assert fast.bent > 8.0 * slow.bent, "m: with the square of the rate"
    assert slow.asleep > fast.asleep
    assert all(one.off < max(0.3 * one.bent, WAKE_DISPLACEMENT) for one in found), (
        "it bends as they do, where that is visible"
    )
    result = as_json(found)
    assert [bound["met"] for bound in result["bounds"]] == [True]
    assert "120" in text(organ, result)
    assert as_json([slow._replace(most_off=0.06 * DISPLACEMENT)])["bounds"][0]["met"] is False
