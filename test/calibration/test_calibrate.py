"""What a calibration begins with."""

from helpers.scenes import ball
from tissue_sim.calibration import calibrate as pipeline


def test_hardening_is_the_default_for_springs_and_the_organs_own_for_groups():
    for method, wanted in (("springs", pipeline.HARDENING), ("groups", 0.0)):
        assert pipeline.prepared(ball(2), pipeline.Settings(method=method)).hardening == wanted
    assert pipeline.prepared(ball(2), pipeline.Settings(hardening=0.5)).hardening == 0.5
