"""Presses, holds and strokes in streams that are made by hand, and by the model."""

import numpy as np
import pytest

from tissue_sim.errors import UserError
from tissue_sim.identification.friction import friction_of
from tissue_sim.identification.measured import MeasuredStroke
from tissue_sim.identification.stream import Stream, depths_in, found_in

RADIUS, TOP = 0.007, 0.03  # m, of the tool and of the ball that it presses
BIAS = np.array([0.05, -0.02, 0.03])  # N
RATE = 200.0  # Hz


def stream_of(legs, stiffness=100.0, friction=0.3):
    """A tool over the top of the ball, through (arc, depth) at times; it pushes back in proportion to its depth."""
    times, along, deep = (np.array(column) for column in zip(*legs, strict=True))
    time = np.arange(0.0, times[-1], 1.0 / RATE)
    x, depth = np.interp(time, times, along), np.interp(time, times, deep)
    turn = x / (TOP + RADIUS)
    out = np.stack([np.sin(turn), 0.0 * turn, np.cos(turn)], axis=1)
    forth = np.stack([np.cos(turn), 0.0 * turn, -np.sin(turn)], axis=1)
    push = stiffness * np.maximum(depth, 0.0)[:, None]
    force = push * out - friction * push * np.sign(np.round(np.gradient(x, time), 6))[:, None] * forth + BIAS
    return Stream("stream", time, (TOP + RADIUS - depth)[:, None] * out, force)


TWO = [(0, 0, -0.004), (1, 0, 0.002), (2, 0, 0.002), (3, 0, -0.004), (4, 0.008, -0.004), (5, 0.008, 0.003)]
TWO += [(6, 0.008, -0.004)]


def test_depths_are_those_of_a_ball_in_a_ball(organ):
    heights = np.array([0.04, 0.037, 0.036, 0.03, 0.02])
    found = depths_in(organ, heights[:, None] * [0.0, 0.0, 1.0], RADIUS)
    np.testing.assert_allclose(found, TOP + RADIUS - heights, atol=4e-4)


def test_two_presses_are_found_without_the_bias(organ):
    found = found_in(stream_of(TWO), organ, RADIUS)
    first, second = found.presses
    assert first.deepest == pytest.approx(0.002, abs=3e-4)
    assert second.deepest == pytest.approx(0.003, abs=5e-4)
    assert first.forces[-1] == pytest.approx(0.2, rel=0.06)
    assert abs(first.forces[first.depths < -3e-4]).max() < 0.01, "the bias is gone"
    np.testing.assert_allclose(first.direction, [0.0, 0.0, -1.0], atol=1e-6)
    assert first.speed == pytest.approx(0.006, rel=0.05)
    assert (np.diff(first.depths) > 0.0).all()
    (hold,) = [one for one in found.holds if one.length > 0.5]
    assert hold.length == pytest.approx(1.0, abs=0.05)
    assert not found.strokes


def test_a_stroke_has_its_friction(organ):
    found = found_in(stream_of([(0, 0, -0.004), (1, 0, 0.002), (3, 0.012, 0.002), (4, 0.012, -0.004)]), organ, RADIUS)
    friction, line = friction_of(found.strokes)
    assert friction.coefficient == pytest.approx(0.3, abs=0.05)
    assert "friction: 0." in line


def test_friction_is_not_reported_without_a_stroke_or_with_a_wrong_sign():
    assert friction_of([])[0] is None
    assert friction_of([MeasuredStroke("one", np.ones(3), -np.ones(3), 0.01)])[0] is None


def test_what_is_no_press_is_refused(organ):
    far = stream_of([(0, 0, -0.02), (1, 0, -0.01), (2, 0, -0.02)])
    with pytest.raises(UserError, match="no press was found"):
        found_in(far, organ, RADIUS)
    inward = stream_of(TWO)
    with pytest.raises(UserError, match="--negate"):
        found_in(inward._replace(forces=-inward.forces), organ, RADIUS)
    with pytest.raises(UserError, match="do not increase"):
        found_in(inward._replace(time=inward.time[::-1]), organ, RADIUS)
