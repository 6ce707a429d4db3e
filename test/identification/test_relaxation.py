"""Relaxation in holds: a solid with one Prony term gives its fraction and time constant back, or the reason why not."""

import numpy as np
import pytest

from tissue_sim.identification.measured import Hold
from tissue_sim.identification.relaxation import relaxation_of, relaxed

RATE = 100.0  # Hz
FRACTION, CONSTANT = 0.35, 3.0
DEEP = 3e-3  # m


def elastic_of(depths):
    """Hertz, up to a factor."""
    return 2000.0 * np.maximum(depths, 0.0) ** 1.5


def held(length=20.0, way_in=0.5, fraction=FRACTION, constant=CONSTANT, noise=0.0, seed=0):
    """A hold after a ramp, of tissue that relaxes; forces in another unit than the model's."""
    time = np.arange(-way_in, length, 1.0 / RATE)
    depths = DEEP * np.clip(1.0 + time / way_in, 0.0, 1.0)
    forces = 1.7 * relaxed(time, elastic_of(depths), fraction, constant)
    forces += noise * forces.max() * np.random.default_rng(seed).normal(size=len(time))
    return Hold("press 1", time, depths, forces)


def found_in(*holds):
    return relaxation_of(holds, [elastic_of(hold.depths) for hold in holds], True)


def test_a_step_decays_as_the_closed_form():
    time = np.concatenate([[-1e-9], np.linspace(0.0, 10.0, 200)])
    elastic = np.concatenate([[0.0], np.ones(200)])
    wanted = 1.0 - FRACTION * (1.0 - np.exp(-time[1:] / CONSTANT))
    np.testing.assert_allclose(relaxed(time, elastic, FRACTION, CONSTANT)[1:], wanted, atol=1e-6)


def test_a_ramp_decays_as_the_closed_form():
    """Of a rate 1: t - g (t - tau (1 - exp(-t / tau)))."""
    time = np.linspace(0.0, 8.0, 50)
    wanted = time - FRACTION * (time - CONSTANT * (1.0 - np.exp(-time / CONSTANT)))
    np.testing.assert_allclose(relaxed(time, time, FRACTION, CONSTANT), wanted, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("way_in", [0.05, 0.5, 6.0])
def test_fraction_and_time_constant_come_back_however_slow_the_way_in(way_in):
    found, line = found_in(held(way_in=way_in, noise=0.01))
    assert found.fraction == pytest.approx(FRACTION, abs=max(0.01, 3.0 * found.fraction_deviation))
    assert found.time == pytest.approx(CONSTANT, rel=0.05, abs=3.0 * found.time_deviation)
    assert found.fraction_deviation < 0.03
    assert found.left < 0.02
    assert "time constant" in line
    assert "unexplained" not in line


def test_a_fitted_exponential_alone_would_miss_what_relaxes_on_the_way_in():
    """The yardstick: much has relaxed by the time of the stop, which a decay from there can't know."""
    hold = held(way_in=6.0)
    after = hold.forces[hold.time >= 0.0]
    assert 1.0 - after[-1] / after[0] < 0.75 * FRACTION
    assert found_in(hold)[0].fraction == pytest.approx(FRACTION, abs=0.01)


def test_deviations_hold_the_truth():
    hits = 0
    for seed in range(20):
        found, _ = found_in(held(noise=0.02, seed=seed))
        hits += abs(found.fraction - FRACTION) < 2.0 * found.fraction_deviation
        hits += abs(found.time - CONSTANT) < 2.0 * found.time_deviation
    assert hits >= 34


def test_holds_that_differ_widen_the_deviation():
    alike = found_in(*[held(seed=seed, noise=0.005) for seed in range(4)])[0]
    other = found_in(*[held(fraction=fraction, noise=0.005) for fraction in (0.25, 0.3, 0.4, 0.45)])[0]
    assert other.fraction_deviation > 3.0 * alike.fraction_deviation
    assert other.holds == 4


def test_a_second_time_constant_is_reported():
    hold = held(constant=8.0)
    fast = 1.7 * relaxed(hold.time, elastic_of(hold.depths), FRACTION, 0.5)
    found, line = found_in(hold._replace(forces=0.5 * (hold.forces + fast)))
    assert found.left > 0.01
    assert "unexplained" in line


@pytest.mark.parametrize(
    ("hold", "why"),
    [
        (held(length=2.5), "the longest hold lasts 2.5 s"),
        (held(fraction=0.0, noise=0.01), "no fraction of the force decays above its noise"),
        (held(length=11.0, constant=80.0, noise=0.005), "hold longer"),
    ],
)
def test_what_cannot_be_identified_is_reported_with_its_reason(hold, why):
    found, line = found_in(hold)
    assert found is None
    assert "not identifiable" in line
    assert why in line


def test_without_times_nothing_is_reported():
    assert "no times" in relaxation_of([], [], False)[1]


def test_the_loss_factor_is_that_of_the_closed_form():
    """Tangent of the phase of 1 - g + g i w tau / (1 + i w tau)."""
    found, _ = found_in(held())
    turn = 2j * np.pi * 0.2 * found.time
    modulus = 1.0 - found.fraction + found.fraction * turn / (1.0 + turn)
    assert found.loss_factor(0.2) == pytest.approx(modulus.imag / modulus.real)
