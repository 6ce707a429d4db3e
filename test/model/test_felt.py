"""Clamp, slew limit and fading of what the hands feel, against a plain NumPy version."""

from types import SimpleNamespace

import numpy as np
import pytest

from tissue_sim.model.felt import clamp_share, report_wrenches, slew_share
from tissue_sim.model.settings import Settings
from tissue_sim.model.state import Counts, ToolStatus

TICK = 1e-3


def settings_of(clamp=10.0, slew=1e3):
    settings = Settings.new()
    settings.tick_time, settings.force_clamp, settings.force_slew = TICK, clamp, slew
    settings.stale_time, settings.ramp_time = 0.05, 0.02
    return settings


def twin(felt, impulse, hands, ages, settings):
    """What report_wrenches does, hand by hand."""
    felt, wrench = felt.copy(), np.zeros_like(felt)
    for hand in np.unique(hands):
        own = hands == hand
        wanted = -impulse[own] / TICK
        size = np.linalg.norm(wanted[:, :3].sum(axis=0))
        wanted *= min(1.0, settings.force_clamp / size) if size else 1.0
        step = np.linalg.norm((wanted - felt[own])[:, :3].sum(axis=0))
        share = min(1.0, settings.force_slew * TICK / step) if step else 1.0
        felt[own] += share * (wanted - felt[own])
        size = np.linalg.norm(felt[own][:, :3].sum(axis=0))
        felt[own] *= min(1.0, settings.force_clamp / size) if size else 1.0
        late = ages[own] * TICK - settings.stale_time
        wrench[own] = np.clip(1.0 - late / settings.ramp_time, 0.0, 1.0)[:, None] * felt[own]
    return felt, wrench


@pytest.mark.parametrize("seed", range(5))
def test_kernel_is_the_twin(seed):
    random = np.random.default_rng(seed)
    hands = np.array([0, 0, 1, 2, 2])
    felt, impulse = random.normal(0.0, 2.0, (5, 6)), random.normal(0.0, 6e-3, (5, 6))
    ages = np.array([3, 3, 55, 80, 0])
    settings = settings_of(clamp=5.0, slew=2e3)
    count, tools = Counts.new(), ToolStatus.rows(np.zeros(5 * ToolStatus.words(), dtype=np.int64))
    tools.age = ages
    expected = twin(felt, impulse, hands, ages, settings)
    state = SimpleNamespace(felt=felt, wrench=np.zeros((5, 6)), tools=tools, count=count)
    report_wrenches.py_func(state, SimpleNamespace(hand=hands), settings, SimpleNamespace(impulse=impulse))
    np.testing.assert_allclose(state.felt, expected[0], rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(state.wrench, expected[1], rtol=1e-12, atol=1e-12)
    for hand in range(3):
        assert np.linalg.norm(state.wrench[hands == hand, :3].sum(axis=0)) <= 5.0 + 1e-12


def test_compiled_shares_are_the_plain_ones():
    random = np.random.default_rng(0)
    hands = np.array([0, 0, 1])
    felt, impulse = random.normal(0.0, 2.0, (3, 6)), random.normal(0.0, 6e-3, (3, 6))
    settings = settings_of(slew=500.0)
    assert clamp_share(felt, hands, 0, 1.0) == clamp_share.py_func(felt, hands, 0, 1.0) < 1.0
    found = slew_share(felt, impulse, -1e3, hands, 1, settings)
    assert found == slew_share.py_func(felt, impulse, -1e3, hands, 1, settings) < 1.0


def test_nip_of_two_jaws_is_not_cut_when_their_sum_is_small():
    hands = np.zeros(2, dtype=np.int64)
    impulse = np.zeros((2, 6))
    impulse[:, 0] = 20.0 * TICK, -19.0 * TICK
    assert clamp_share(impulse, hands, 0, 10.0 * TICK) == 1.0
