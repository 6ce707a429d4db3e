"""Stiffness and masses together: slopes against finite differences, and a longer step at little cost."""

import numpy as np
import pytest

from helpers.springs_of_ball import MODEL, ORGAN, SPRINGS, START, linear_answers
from tissue_sim.calibration.cases import fit_cases
from tissue_sim.calibration.fit import Misfit
from tissue_sim.calibration.inertia import frequencies_of, tissue_mass
from tissue_sim.calibration.joint_fit import Together, fit_together
from tissue_sim.model.elasticity.frequency import largest_frequency

FORCE = fit_cases(ORGAN, 12, 0)
TRUTH = START * np.exp(0.2 * np.random.default_rng(7).standard_normal(len(START)))
MISFIT = Misfit(SPRINGS, FORCE, linear_answers(TRUTH, FORCE))
AROUND = tissue_mass(ORGAN)
LOWEST = frequencies_of(SPRINGS, TRUTH, AROUND, 4)


def fastest(stiffness, mass):
    """rad/s."""
    root = 1.0 / np.sqrt(np.repeat(mass, 3)[SPRINGS.free])
    return float(np.sqrt(np.linalg.eigvalsh(root[:, None] * SPRINGS.tangent(stiffness).toarray() * root)[-1]))


def test_slopes_are_those_by_finite_differences():
    together = Together(ORGAN, MISFIT, START, LOWEST, 0.8 * fastest(START, AROUND))
    random = np.random.default_rng(1)
    at = together.join(START, AROUND)
    at = at + 0.1 * random.standard_normal(len(at))
    _, slope, _ = together.evaluate(at, 0.3, 0.5)
    for way in random.standard_normal((6, len(at))):
        ahead, behind = (together.evaluate(at + sign * 1e-5 * way, 0.3, 0.5)[0] for sign in (1.0, -1.0))
        assert slope @ way == pytest.approx((ahead - behind) / 2e-5, rel=2e-3)
    count = len(START)
    for part in (slice(0, count), slice(count, None)):
        assert np.abs(slope[part]).max() > 0.0


def test_stiffness_and_masses_come_back():
    together = Together(ORGAN, MISFIT, START, LOWEST, 1e3)
    stiffness, mass = together.split(together.join(TRUTH, AROUND))
    np.testing.assert_allclose(stiffness, TRUTH)
    np.testing.assert_allclose(mass, AROUND)


@pytest.mark.extended
def test_a_longer_step_is_stable_and_the_lowest_modes_stay():
    before = fastest(TRUTH, AROUND)
    together = Together(ORGAN, MISFIT, START, LOWEST, 0.75 * before)
    seen = []
    stiffness, mass = fit_together(
        together, TRUTH, AROUND, 90, (-3.5, 2.5), lambda number, error: seen.append(error.mean())
    )
    assert 1 < len(seen) < 120  # a search along a line may end a little later
    assert fastest(stiffness, mass) < 0.77 * before
    assert np.abs(frequencies_of(SPRINGS, stiffness, mass, 4) / LOWEST - 1.0).max() < 0.01
    assert seen[-1] < 0.05
    held = np.setdiff1d(np.arange(len(mass)), SPRINGS.free[::3] // 3)
    np.testing.assert_array_equal(mass[held], AROUND[held])


def test_fastest_here_is_that_of_the_model():
    mass = np.where(MODEL.inverse_mass > 0.0, 1.0 / np.maximum(MODEL.inverse_mass, 1e-300), 1.0)
    assert fastest(START, mass) == pytest.approx(largest_frequency(MODEL), rel=0.02)
