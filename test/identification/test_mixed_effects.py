"""The fit: what it recovers from forces with noise, bias and offsets, and how its interval holds the truth."""

import numpy as np
import pytest

from tissue_sim.identification.diagnosis import diagnosed, exponent_of
from tissue_sim.identification.force_curves import hertz, tabulated
from tissue_sim.identification.measured import Samples
from tissue_sim.identification.mixed_effects import Priors, fitted
from tissue_sim.identification.uncertainty import drawn_factors, interval_of

FACTOR, BIAS = 0.63, 0.01
COUNT = 12
DEPTHS = np.tile(np.concatenate([np.linspace(-1e-3, -1e-4, 6), np.linspace(1e-4, 4e-3, 20)]), (COUNT, 1))
CURVES = tabulated(*([one] for one in hertz(0.005, 10e3, 0.45, 0.006)), np.zeros(COUNT, dtype=np.int64))


def measured(random, offset=2e-4, spread=0.05, noise=0.005, power=1.0):
    """Forces of presses with noise, a bias, offsets and a spread of moduli."""
    own = offset * random.normal(size=(COUNT, 1))
    force = CURVES.at(DEPTHS + own)[0]
    force = FACTOR * force.max() * (force / force.max()) ** power * np.exp(spread * random.normal(size=(COUNT, 1)))
    force = force * (1.0 + 0.02 * random.normal(size=force.shape)) + noise * random.normal(size=force.shape) + BIAS
    return Samples(DEPTHS, force, np.ones_like(force)), own[:, 0]


def test_without_noise_the_factor_offsets_and_bias_come_back():
    samples, own = measured(np.random.default_rng(0), spread=0.0, noise=0.0)
    exact = FACTOR * CURVES.at(DEPTHS + own[:, None])[0] + BIAS
    fit = fitted(CURVES, samples._replace(forces=exact), Priors())
    assert fit.factor == pytest.approx(FACTOR, rel=1e-3)
    assert fit.common[2] == pytest.approx(BIAS, abs=1e-4)
    np.testing.assert_allclose(fit.common[1] + fit.own[:, 1], own, atol=5e-6)


def test_the_factor_is_within_eight_percent_with_unknown_offsets():
    random = np.random.default_rng(1)
    found = [fitted(CURVES, measured(random)[0], Priors()).factor / FACTOR for _ in range(50)]
    assert abs(np.mean(found) - 1.0) < 0.02
    assert np.abs(np.array(found) - 1.0).max() < 0.08


def test_ignoring_the_offsets_costs_more():
    random = np.random.default_rng(2)
    made = [measured(random, offset=3e-4)[0] for _ in range(20)]
    errors = [[abs(fitted(CURVES, one, Priors(offset=o)).factor / FACTOR - 1) for one in made] for o in (3e-4, 1e-6)]
    assert np.mean(errors[0]) < np.mean(errors[1])


def test_places_that_are_far_off_hardly_move_the_factor():
    samples, _ = measured(np.random.default_rng(3))
    forces = samples.forces.copy()
    forces[:2] = 4.0 * (forces[:2] - BIAS) + BIAS
    fit = fitted(CURVES, samples._replace(forces=forces), Priors())
    assert fit.factor == pytest.approx(fitted(CURVES, samples, Priors()).factor, rel=0.06)
    assert (fit.own[:2, 0] > 1.0).all()


def test_intervals_hold_the_truth():
    random, held = np.random.default_rng(4), 0
    for seed in range(20):
        samples, _ = measured(random, spread=0.08)
        fit = fitted(CURVES, samples, Priors())
        drawn = drawn_factors(CURVES, samples, Priors(), fit, np.arange(COUNT), seed)
        interval = interval_of(fit, drawn, COUNT, 0.0)
        held += interval.low < FACTOR < interval.high
        assert interval.high / interval.low < 1.3
    assert held >= 17, "19 of 20 are expected of a 95 % interval"


def test_samples_that_do_not_count_change_nothing():
    samples, _ = measured(np.random.default_rng(5))
    odd = samples._replace(forces=samples.forces.copy(), counts=samples.counts.copy())
    odd.counts[:, ::3] = 0.0
    before = fitted(CURVES, odd, Priors()).factor
    odd.forces[:, ::3] = 100.0
    assert fitted(CURVES, odd, Priors()).factor == pytest.approx(before, rel=1e-12)


def test_the_exponent_of_power_laws_is_found():
    for power in (1.2, 2.0, 3.0):
        forces = 50.0 * (np.maximum(DEPTHS + 3e-4, 0.0) / 1e-3) ** power
        assert exponent_of(Samples(DEPTHS, forces, np.ones_like(forces))) == pytest.approx(power, abs=0.11)


def test_tissue_that_stiffens_is_reported():
    priors = Priors()
    for power, stiffens in ((1.0, False), (2.0, True)):
        samples, _ = measured(np.random.default_rng(6), offset=5e-5, noise=1e-3, power=power)
        seen = diagnosed(CURVES, samples, priors, fitted(CURVES, samples, priors))
        assert seen.stiffens is stiffens
        assert (seen.holds_to > 3.9e-3) or stiffens
