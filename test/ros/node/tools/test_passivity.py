"""The passivity observer on a force's way to its device."""

from types import SimpleNamespace

import numpy as np
import pytest

from helpers.scenes import ball
from tissue_sim.model.simulation import Simulation
from tissue_sim.ros.node.tools.passivity import DevicePort

OUT = np.array([1e-4, 0.0, 0.0])  # m that a device moves between two poses
PUSH = np.array([1.0, 0.0, 0.0, 0.01, 0.0, 0.0])  # N, N m


def port(most=5.0, clamp=10.0, delay=0.0, scale=1.0):
    settings = Simulation(ball(1)).settings
    settings.force_clamp = clamp
    return DevicePort(SimpleNamespace(period=1e-3, delay=delay), scale, most, lambda: settings)


def moved(device, displacement, count, wrench=PUSH):
    """What a device feels that moves by so much between poses."""
    return np.array([device.passive_wrench(step * displacement, wrench) for step in range(count)])


def test_force_that_a_device_follows_is_damped():
    wrenches = moved(port(), OUT, 10)
    np.testing.assert_array_equal(wrenches[:2], [PUSH, PUSH])
    assert np.all(wrenches[3:, 0] == pytest.approx(1.0 - 5.0 * 0.1)), "as much as may be added, at 0.1 m/s"
    np.testing.assert_array_equal(wrenches[:, 1:], np.tile(PUSH[1:], (10, 1)))


def test_force_that_a_device_presses_against_is_not():
    device = port()
    np.testing.assert_array_equal(moved(device, -OUT, 10), np.tile(PUSH, (10, 1)))
    assert device.damped == 0


def test_what_a_device_has_put_in_may_come_back():
    device = port()
    moved(device, -OUT, 11)
    back = np.array([device.passive_wrench(-1e-3 * np.array([1.0, 0.0, 0.0]) + step * OUT, PUSH) for step in range(20)])
    assert back[:10, 0] == pytest.approx(1.0, abs=1e-9)
    assert back[-1, 0] < 1.0


def test_device_that_is_driven_gets_no_more_than_some_periods_give():
    """However much damping that takes."""
    wrenches = moved(port(most=1e9), OUT, 200)
    got = np.cumsum(wrenches[:-1, 0] * OUT[0])
    assert got.max() <= 4.0 * PUSH[0] * OUT[0]
    assert moved(port(most=0.0), OUT, 200)[:, 0].sum() * OUT[0] > 40.0 * got.max(), "as it would be without"


def test_forces_count_when_they_act():
    """With 10 ms there and back, and a tick: the first ten periods of a motion are under no force."""
    wrenches = moved(port(delay=5e-3), OUT, 30)
    assert np.all(wrenches[:11, 0] == 1.0)
    assert np.all(wrenches[13:, 0] < 1.0)


def test_clamp_holds_and_scale_counts():
    jump = np.array([0.01, 0.0, 0.0])
    wrenches = moved(port(most=50.0, clamp=2.0), jump, 10)
    assert np.linalg.norm(wrenches[:, :3], axis=1).max() <= 2.0 * (1.0 + 1e-12)
    scaled = moved(port(scale=0.1), 0.1 * OUT, 10)
    np.testing.assert_allclose(scaled, moved(port(), OUT, 10), rtol=1e-9)


def test_without_damping_and_without_numbers_nothing_changes():
    device = port(most=0.0)
    assert moved(device, OUT, 10).tolist() == np.tile(PUSH, (10, 1)).tolist()
    bad = np.full(6, np.nan)
    device = port()
    assert device.passive_wrench(OUT, bad) is bad
    assert np.isfinite(moved(device, OUT, 10)).all()
    device.forget()
    np.testing.assert_array_equal(device.passive_wrench(OUT, PUSH), PUSH)


def test_a_damped_force_stands_until_the_next_pose_is_overdue_or_the_last_one_stale():
    device = port()
    assert device.patience == pytest.approx(1.5e-3)
    assert port(most=0.0).patience == 0.0, "what is not damped is renewed at the tick rate"
    slow = DevicePort(SimpleNamespace(period=0.1, delay=0.0), 1.0, 5.0, lambda: Simulation(ball(1)).settings)
    assert slow.patience == pytest.approx(0.05), "stale_time"
