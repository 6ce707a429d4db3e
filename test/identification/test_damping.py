"""Damping from sinusoids, beside the model with a known damping."""

import numpy as np
import pytest

from tissue_sim.identification.damping import MOST, damping_of, line_of, model_loss
from tissue_sim.identification.measured import MeasuredPress, Sinusoid
from tissue_sim.identification.pressing import Press, ball
from tissue_sim.identification.relaxation import Relaxation
from tissue_sim.identification.sinusoids import Loss

FINGER, FRICTION = 0.007, 0.6
MIDDLE, AMPLITUDE, FREQUENCY = 2e-3, 3e-4, 4.0
SCALE = 2.0


@pytest.fixture(scope="module")
def swing(places):
    """A press at a flat place, and a sinusoid there."""
    spot = places[0][0]
    press = MeasuredPress(
        "press 1", np.zeros(1), np.zeros(1), spot.point - FINGER * spot.direction, spot.direction, np.zeros((0, 3))
    )
    time = np.arange(0.0, 1.0, 0.002)
    return press, Sinusoid("press 1", time, MIDDLE + AMPLITUDE * np.sin(2 * np.pi * FREQUENCY * time), 0.0 * time)


@pytest.fixture(scope="module")
def measured(organ, swing):
    """The loss factor of the model with twice its damping."""
    press, _ = swing
    scene = ball(organ, FINGER, FRICTION)
    return model_loss(scene, Press(press.place, press.direction), (MIDDLE, AMPLITUDE, FREQUENCY), SCALE)


def found_for(organ, swing, loss, relaxation=None, kept=None):
    press, sinusoid = swing
    kept = {} if kept is None else kept

    def remember(name, make):
        if name not in kept:
            kept[name] = make()
        return kept[name]

    loss = Loss(loss, 0.001, FREQUENCY, 80.0)
    return damping_of(organ, [(sinusoid, press, 0.0)], loss, relaxation, (FINGER, FRICTION), remember)


def test_the_damping_of_the_model_comes_back(organ, swing, measured):
    kept = {}
    found = found_for(organ, swing, measured, kept=kept)
    assert found.scale == pytest.approx(SCALE, rel=0.1)
    assert found.own < measured
    assert "with damping_scale" in line_of(found)
    before = dict(kept)
    assert found_for(organ, swing, measured, kept=kept).scale == found.scale
    assert kept.keys() == before.keys()


@pytest.mark.extended
def test_what_relaxation_causes_is_no_damping(organ, swing, measured):
    relaxation = Relaxation(0.3, 2.0, 0.0, 0.0, 1, 0.0)
    caused = relaxation.loss_factor(FREQUENCY)
    assert caused > 0.005
    found = found_for(organ, swing, measured + caused, relaxation)
    assert found.scale == pytest.approx(SCALE, rel=0.1)
    assert found.ratio == pytest.approx(0.5 * measured)


@pytest.mark.extended
def test_more_than_the_model_can_lose_is_reported(organ, swing):
    found = found_for(organ, swing, 1.5)
    assert np.isnan(found.scale)
    assert f"to {MOST:g} gives the measured one" in line_of(found)
