"""A breath that goes where it is given."""

import numpy as np
import pytest

from tissue_sim.model.stepping.breathing import FOLLOW_RATE, Breath, follow


def led(given, seconds, step=1e-3):
    """Share, speed and acceleration at every step of a breath that is given a share at each time."""
    breath, rows = Breath.new(), []
    breath.follows = True
    for time in np.arange(0.0, seconds, step):
        breath.target = given(time)
        rows.append(follow(breath, step))
    return np.array(rows)


def test_it_comes_to_where_it_is_told_without_going_beyond():
    """As a critically damped spring: 1 - (1 + w t) exp(-w t)."""
    found = led(lambda _: 1.0, 1.0)
    time = 1e-3 * (1.0 + np.arange(len(found)))
    np.testing.assert_allclose(found[:, 0], 1.0 - (1.0 + FOLLOW_RATE * time) * np.exp(-FOLLOW_RATE * time), atol=0.01)
    assert found[:, 0].max() <= 1.0
    assert found[-1, 0] == pytest.approx(1.0, abs=1e-6)
    assert np.abs(found[:, 2]).max() <= FOLLOW_RATE**2


def test_it_follows_a_breath_a_tenth_of_a_second_behind():
    period = 4.0
    found = led(lambda time: np.sin(np.pi * time / period) ** 4, 8.0)
    time = 1e-3 * np.arange(len(found))
    wanted = np.sin(np.pi * (time - 2.0 / FOLLOW_RATE) / period) ** 4
    late = time > 1.0
    np.testing.assert_allclose(found[late, 0], wanted[late], atol=0.01)


def test_speed_and_acceleration_are_those_of_the_share():
    found = led(lambda time: 0.5 + 0.5 * np.sin(3.0 * time), 2.0)
    np.testing.assert_allclose(np.diff(found[:, 0]), 1e-3 * found[1:, 1], atol=1e-15)
    np.testing.assert_allclose(np.diff(found[:, 1]), 1e-3 * found[1:, 2], atol=1e-12)
