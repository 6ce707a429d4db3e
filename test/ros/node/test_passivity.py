"""The passivity observer on a force's way to its device."""

from types import SimpleNamespace

import numpy as np
import pytest

from helpers.scenes import ball
from tissue_sim.model.simulation import Simulation
from tissue_sim.ros.node.passivity import DevicePort, Observer

OUT = np.array([1e-4, 0.0, 0.0])  # m that a device moves between two poses
PUSH = np.array([1.0, 0.0, 0.0, 0.01, 0.0, 0.0])  # N, N m


def port(most=5.0, clamp=10.0, delay=0.0, scale=1.0):
    settings = Simulation(ball(1)).settings
    settings.force_clamp = clamp
    return DevicePort(SimpleNamespace(period=1e-3, delay=delay), scale, most, lambda: settings)


def moved(device, way, count, wrench=PUSH):
    """What a device feels that moves by so much between poses."""
    return np.array([device.felt(step * way, wrench) for step in range(count)])


def test_force_that_a_device_follows_is_damped():
    felt = moved(port(), OUT, 10)
    np.testing.assert_array_equal(felt[:2], [PUSH, PUSH])
    assert np.all(felt[3:, 0] == pytest.approx(1.0 - 5.0 * 0.1)), "as much as may be added, at 0.1 m/s"
    np.testing.assert_array_equal(felt[:, 1:], np.tile(PUSH[1:], (10, 1)))


def test_force_that_a_device_presses_against_is_not():
    device = port()
    np.testing.assert_array_equal(moved(device, -OUT, 10), np.tile(PUSH, (10, 1)))
    assert device.damped == 0


def test_what_a_device_has_put_in_may_come_back():
    device = port()
    moved(device, -OUT, 11)
    back = np.array([device.felt(-1e-3 * np.array([1.0, 0.0, 0.0]) + step * OUT, PUSH) for step in range(20)])
    assert np.all(back[:10, 0] == 1.0)
    assert back[-1, 0] < 1.0


def test_no_more_energy_than_was_put_in_for_a_force_that_acts_at_once():
    """Unbounded damping: all that the last period gave is taken out in the next."""
    observer, got, force = Observer(), 0.0, np.zeros(3)
    rng, place = np.random.default_rng(2), np.zeros(3)
    for _ in range(500):
        step = rng.normal(0.0, 1e-4, 3)
        got += float(force @ step)
        place = place + step
        force = observer.damped(place, rng.normal(0.0, 1.0, 3), 1e-3, 0.0, 1e9)
        observer.sent(force)
    assert abs(got) < 0.1 * 500 * 1e-4


def test_forces_count_when_they_act():
    """With 10 ms there and back, and a tick: the first ten periods of a motion are under no force."""
    felt = moved(port(delay=5e-3), OUT, 30)
    assert np.all(felt[:11, 0] == 1.0)
    assert np.all(felt[13:, 0] < 1.0)


def test_clamp_holds_and_scale_counts():
    jump = np.array([0.01, 0.0, 0.0])
    felt = moved(port(most=50.0, clamp=2.0), jump, 10)
    assert np.linalg.norm(felt[:, :3], axis=1).max() <= 2.0 * (1.0 + 1e-12)
    scaled = moved(port(scale=0.1), 0.1 * OUT, 10)
    np.testing.assert_allclose(scaled, moved(port(), OUT, 10), rtol=1e-9)


def test_without_damping_and_without_numbers_nothing_changes():
    device = port(most=0.0)
    assert moved(device, OUT, 10).tolist() == np.tile(PUSH, (10, 1)).tolist()
    bad = np.full(6, np.nan)
    device = port()
    assert device.felt(OUT, bad) is bad
    assert np.isfinite(moved(device, OUT, 10)).all()
    device.forget()
    np.testing.assert_array_equal(device.felt(OUT, PUSH), PUSH)
