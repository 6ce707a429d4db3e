"""Clamp, slew limit and fading of the wrench, against a plain NumPy version."""

from types import SimpleNamespace

import numpy as np
import pytest

from tissue_sim.model.contact.haptic_output import clamp_fraction, compute_haptic_output, slew_fraction
from tissue_sim.model.data.settings import Settings
from tissue_sim.model.data.state import BodyStatus, Counts

TICK = 1e-3


def settings_of(clamp=10.0, slew=1e3):
    settings = Settings.new()
    settings.tick_time, settings.force_clamp, settings.force_slew = TICK, clamp, slew
    settings.stale_time, settings.ramp_time = 0.05, 0.02
    return settings


def scratch_of(impulse):
    return SimpleNamespace(impulse=impulse, slew_part=np.ones(len(impulse)))


def twin(unfaded, felt, impulse, owners, ages, settings):
    """What compute_haptic_output does, tool by tool; felt: the wrench (b, 6) of the tick before."""
    unfaded, wrench = np.where(ages[:, None] * TICK <= settings.stale_time, felt, unfaded), np.zeros_like(unfaded)
    for tool in np.unique(owners):
        own = owners == tool
        wanted = -impulse[own] / TICK
        size = np.linalg.norm(wanted[:, :3].sum(axis=0))
        wanted *= min(1.0, settings.force_clamp / size) if size else 1.0
        step = np.linalg.norm((wanted - unfaded[own])[:, :3].sum(axis=0))
        fraction = min(1.0, settings.force_slew * TICK / step) if step else 1.0
        unfaded[own] += fraction * (wanted - unfaded[own])
        size = np.linalg.norm(unfaded[own][:, :3].sum(axis=0))
        unfaded[own] *= min(1.0, settings.force_clamp / size) if size else 1.0
        late = ages[own] * TICK - settings.stale_time
        fresh = np.clip(1.0 - late / settings.ramp_time, 0.0, 1.0)[:, None]
        unfaded[own] *= fresh > 0.0
        wrench[own] = fresh * unfaded[own]
    return unfaded, wrench


@pytest.mark.parametrize("seed", range(5))
def test_kernel_is_the_twin(seed):
    random = np.random.default_rng(seed)
    owners = np.array([0, 0, 1, 2, 2])
    unfaded, impulse = random.normal(0.0, 2.0, (5, 6)), random.normal(0.0, 6e-3, (5, 6))
    felt = 0.3 * unfaded
    ages = np.array([3, 3, 55, 80, 0])
    settings = settings_of(clamp=5.0, slew=2e3)
    count, bodies = Counts.new(), BodyStatus.rows(np.zeros(5 * BodyStatus.words(), dtype=np.int64))
    bodies.age = ages
    expected = twin(unfaded, felt, impulse, owners, ages, settings)
    state = SimpleNamespace(unfaded_wrench=unfaded, wrench=felt, bodies=bodies, count=count)
    compute_haptic_output.py_func(state, SimpleNamespace(tool=owners), settings, scratch_of(impulse))
    np.testing.assert_allclose(state.unfaded_wrench, expected[0], rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(state.wrench, expected[1], rtol=1e-12, atol=1e-12)
    for tool in range(3):
        assert np.linalg.norm(state.wrench[owners == tool, :3].sum(axis=0)) <= 5.0 + 1e-12


def test_compiled_shares_are_the_plain_ones():
    random = np.random.default_rng(0)
    owners = np.array([0, 0, 1])
    unfaded, impulse = random.normal(0.0, 2.0, (3, 6)), random.normal(0.0, 6e-3, (3, 6))
    settings = settings_of(slew=500.0)
    assert clamp_fraction(unfaded, owners, 0, 1.0) == clamp_fraction.py_func(unfaded, owners, 0, 1.0) < 1.0
    most = settings.force_slew * settings.tick_time
    found = slew_fraction(unfaded, impulse, -1e3, owners, 1, most)
    assert found == slew_fraction.py_func(unfaded, impulse, -1e3, owners, 1, most) < 1.0


def test_nip_of_two_jaws_is_not_cut_when_their_sum_is_small():
    owners = np.zeros(2, dtype=np.int64)
    impulse = np.zeros((2, 6))
    impulse[:, 0] = 20.0 * TICK, -19.0 * TICK
    assert clamp_fraction(impulse, owners, 0, 10.0 * TICK) == 1.0


def test_a_force_that_faded_partly_rises_no_faster_than_the_slew_limit():
    """Poses that pause for 50 to 70 ms are common; the whole force came back in one tick."""
    settings, tick = settings_of(slew=500.0), 0
    bodies = BodyStatus.rows(np.zeros(BodyStatus.words(), dtype=np.int64))
    state = SimpleNamespace(unfaded_wrench=np.zeros((1, 6)), wrench=np.zeros((1, 6)), bodies=bodies, count=Counts.new())
    impulse, forces = np.zeros((1, 6)), []
    impulse[0, 2] = -5.0 * TICK
    for tick in range(300):
        since = tick % 100
        bodies.age = max(0, since - 35)  # a pose a tick for 36 ticks, then none until it has faded by three quarters
        compute_haptic_output.py_func(
            state, SimpleNamespace(tool=np.zeros(1, dtype=np.int64)), settings, scratch_of(impulse)
        )
        forces.append(state.wrench[0, 2])
    rises = np.diff(forces)
    assert max(forces) == pytest.approx(5.0)
    assert min(forces[50:]) == pytest.approx(5.0 * (1.0 - 14.0 / 20.0))
    assert rises.max() == pytest.approx(0.5)
