"""Tools that swing in tissue: where they do, and by how much the force runs ahead."""

import numpy as np
import pytest

from tissue_sim.identification.damping import losses_of
from tissue_sim.identification.measured import Sinusoid
from tissue_sim.identification.sinusoids import cycles_of, loss_of

RATE = 500.0  # Hz


def swing(frequency=2.0, loss=0.2, noise=0.0, drift=0.0, rate=RATE, late=0.0):
    """A tool that goes in, swings for six cycles, and goes out; the force of a spring and a damper beside it."""
    lead, cycles = 1.0, 6.0 / frequency
    time = np.arange(0.0, 2.0 * lead + cycles, 1.0 / rate)
    at = time - late

    def depth(moment):
        inside = np.clip(moment / lead, 0.0, 1.0) - np.clip((moment - lead - cycles) / lead, 0.0, 1.0)
        swung = np.where(
            (moment > lead) & (moment < lead + cycles), np.sin(2 * np.pi * frequency * (moment - lead)), 0.0
        )
        return 4e-3 * (inside - 0.25) + 3e-4 * swung

    depths = depth(time)
    speed = (depth(at + 1e-6) - depth(at - 1e-6)) / 2e-6
    forces = (
        100.0 * (np.maximum(depth(at), 0.0) + loss / (2 * np.pi * frequency) * speed * (depth(at) > 0.0)) + drift * time
    )
    return time, depths, forces + noise * np.random.default_rng(0).normal(size=len(time))


def cut(time, depths, forces):
    own = cycles_of(time, depths, int(np.argmax(depths >= 0.96 * depths.max())))
    return None if own is None else Sinusoid("press 1", time[own] - time[own][0], depths[own], forces[own])


@pytest.mark.parametrize(("frequency", "loss"), [(0.5, 0.1), (2.0, 0.2), (8.0, 0.4)])
def test_a_spring_and_a_damper_have_their_loss_factor(frequency, loss):
    found = loss_of(cut(*swing(frequency, loss, noise=0.003, drift=0.01)))
    assert found.frequency == pytest.approx(frequency, rel=0.01)
    assert found.factor == pytest.approx(loss, abs=max(0.01, 3.0 * found.deviation))
    assert found.stiffness == pytest.approx(100.0, rel=0.03)


def test_forces_that_come_late_are_seen_as_less_loss():
    """The yardstick: a delay of 4 ms at 2 Hz takes 0.05 off, which is why stamps must be those of the measurement."""
    found = loss_of(cut(*swing(loss=0.2, late=0.004)))
    assert found.factor == pytest.approx(0.2 - 2 * np.pi * 2.0 * 0.004, abs=0.01)


@pytest.mark.parametrize("what", ["still", "drifts", "one dip", "uneven"])
def test_what_is_no_sinusoid_is_none(what):
    time = np.arange(0.0, 8.0, 1.0 / RATE)
    moved = {
        "still": 0.0 * time,
        "drifts": 2e-4 * time / 8.0,
        "one dip": -3e-4 * np.exp(-((time - 4.0) ** 2)),
        "uneven": 3e-4 * np.sin(2 * np.pi * 0.5 * time**1.5),
    }[what]
    noise = 2e-6 * np.random.default_rng(0).normal(size=len(time))
    assert cycles_of(time, 3e-3 + moved + noise, 0) is None


def test_sinusoids_are_averaged_and_none_is_reported():
    some = [cut(*swing(loss=loss)) for loss in (0.15, 0.25)]
    found, line = losses_of(some, True)
    assert found.factor == pytest.approx(0.2, abs=0.01)
    assert found.deviation == pytest.approx(0.05, abs=0.01)
    assert not line
    for swings, has_times, why in (([], True, "no tool swings"), ([], False, "no times")):
        found, line = losses_of(swings, has_times)
        assert found is None
        assert "not identifiable" in line
        assert why in line


def test_a_lag_within_a_sample_is_not_reported():
    found, line = losses_of([cut(*swing(loss=0.01, rate=50.0))], True)
    assert found is None
    assert "sample faster" in line
