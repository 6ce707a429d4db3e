"""Places that are far stiffer than the others: by the mean of their presses, and none too many."""

import numpy as np
import pytest

from tissue_sim.identification.mixed_effects import Fit
from tissue_sim.identification.stiff_places import line_of, stiff_places

PLACES = 12


def fit_of(own):
    return Fit(np.zeros(3), np.stack([own, np.zeros_like(own)], axis=1), 0.05, 1.0, np.eye(3))


def own_of(random, times=1, stiff=0.0, noise=0.05):
    """Deviations of presses: those between places, and noise; the fourth place is stiffer."""
    place = np.repeat(np.arange(PLACES), times)
    between = 0.03 * random.normal(size=PLACES)
    between[3] = stiff
    return between[place] + noise * random.normal(size=len(place)), place


def test_a_stiff_place_is_named_by_its_stiffest_press():
    own, place = own_of(np.random.default_rng(0), times=3, stiff=0.5, noise=0.01)
    found = stiff_places(fit_of(own), place)
    assert found.presses.tolist() == [9 + int(own[9:12].argmax())]
    assert found.excess == pytest.approx(np.expm1(own[9:12].mean() - np.median(own)), abs=0.05)
    assert "under press 9" in line_of(found, [f"press {place[row] * 3}" for row in range(36)], np.zeros((36, 3)))


def test_pressing_places_again_finds_more_and_raises_no_more_alarms():
    found, alarms = {}, {}
    for times in (1, 5):
        random = np.random.default_rng(1)
        found[times] = sum(
            9 // 3 in place[stiff_places(fit_of(own), place).presses]
            for own, place in (own_of(random, times, 0.22) for _ in range(200))
        )
        alarms[times] = sum(
            len(stiff_places(fit_of(own), place).presses) > 0
            for own, place in (own_of(random, times) for _ in range(200))
        )
    assert found[1] < 150
    assert found[5] > found[1] + 30
    assert alarms[5] <= alarms[1] + 6
    assert alarms[5] < 20


def test_few_places_are_too_few_however_often_they_are_pressed():
    own, place = np.r_[np.zeros(30), np.ones(5)], np.repeat(np.arange(7), 5)
    assert len(stiff_places(fit_of(own), place).presses) == 0
