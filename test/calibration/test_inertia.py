"""Masses: the total is kept, the lowest modes follow the reference, the critical step has room."""

from functools import cache

import numpy as np
import pytest

from helpers.scenes import changed
from helpers.springs_of_ball import MODEL, ORGAN, SPRINGS, START
from tissue_sim.calibration import inertia as motion
from tissue_sim.calibration.inertia import (
    damping_rate,
    fit_mass,
    frequencies_of,
    least_mass,
    tissue_mass,
)
from tissue_sim.errors import UserError
from tissue_sim.model.elasticity.assembly import assemble
from tissue_sim.model.elasticity.frequency import largest_frequency
from tissue_sim.model.elasticity.modes import lowest_modes

tissue_mass = cache(tissue_mass)


def test_tissue_mass_is_that_of_the_volume():
    mass = tissue_mass(ORGAN)
    assert mass.sum() == pytest.approx(ORGAN.density * ORGAN.volume)
    assert np.all(mass > 0.0)
    # A ball's outermost shell holds less of it than what the inner nodes have.
    assert 0.2 < mass[: ORGAN.n_surface].sum() / mass.sum() < 0.7


def test_frequencies_are_those_of_the_model():
    expected = lowest_modes(MODEL, 6).frequency / (2.0 * np.pi)
    np.testing.assert_allclose(frequencies_of(SPRINGS, START, ORGAN.mass, 6), expected, rtol=1e-6)


def test_masses_bring_the_lowest_modes_to_the_frequencies_wanted(monkeypatch):
    around = tissue_mass(ORGAN)
    tilted = around * np.exp(1.5 * ORGAN.rest_positions[:, 0] / 0.03)
    tilted *= around.sum() / tilted.sum()
    wanted = frequencies_of(SPRINGS, START, tilted, 6)
    before = np.abs(frequencies_of(SPRINGS, START, around, 6) / wanted - 1.0).max()
    monkeypatch.setattr(motion, "tissue_mass", tissue_mass)
    mass = fit_mass(ORGAN, SPRINGS, START, wanted)
    after = np.abs(frequencies_of(SPRINGS, START, mass, 6) / wanted - 1.0).max()
    assert before > 0.02
    assert after < 0.25 * before
    assert mass.sum() == pytest.approx(around.sum())
    assert np.all(mass > 0.0)


@pytest.mark.parametrize("step", [1e-4, 3e-4])
def test_least_mass_bounds_the_critical_step(step):
    total = ORGAN.density * ORGAN.volume
    least = least_mass(SPRINGS, SPRINGS.tangent(START), total, step)
    assert least.sum() < 0.5 * total
    model = MODEL._replace(inverse_mass=np.where(MODEL.inverse_mass > 0.0, 1.0 / np.maximum(least, 1e-12), 0.0))
    assert 2.0 / largest_frequency(model) >= step


def test_an_organ_gives_away_more_of_its_mass_the_stiffer_it_is_up_to_a_bound():
    total = ORGAN.density * ORGAN.volume
    needed = least_mass(SPRINGS, SPRINGS.tangent(START), total, 1e-5).sum() / total / 1e-10  # for a step of 1 s
    for wanted, fraction in ((0.4, 0.4), (0.7, 0.6), (1.0, 0.6), (1.2, 0.72), (9.0, 0.75)):
        least = least_mass(SPRINGS, SPRINGS.tangent(START), total, np.sqrt(wanted / needed))
        assert least.sum() == pytest.approx(fraction * total)


def test_an_organ_that_nothing_holds_is_refused():
    loose = changed(ORGAN, return_stiffness=0.0)
    model = assemble(loose)
    free = type(SPRINGS)(model._replace(inverse_mass=np.ones(len(model.rest)), moving=np.arange(len(model.rest))))
    with pytest.raises(UserError, match="not connected to its clamp"):
        fit_mass(loose, free, free.stiffness, np.array([1.0]))


def test_damping_is_critical_for_the_lowest_mode():
    assert damping_rate(np.array([2.0, 5.0])) == pytest.approx(2.0 * (2.0 * np.pi * 2.0))
