"""When a model's answers say nothing of its accuracy: it moves too slowly, or did not come to rest."""

import numpy as np
import pytest

from tissue_sim.calibration.evaluation import LONGEST, TOLERANCE, Answer, check_pace, check_settled
from tissue_sim.errors import UserError


def answers(converged):
    count = len(converged)
    return Answer(np.zeros((count, 3, 3)), np.zeros(count), np.array(converged, dtype=float), np.ones(count))


def test_an_organ_that_comes_to_rest_too_slowly_is_refused():
    """A motion of frequency f, damped critically, is down to the tolerance after log(1 / tolerance) / (2 pi f)."""
    slowest = np.log(1.0 / TOLERANCE) / (2.0 * np.pi * LONGEST)
    check_pace("gut", 1.01 * slowest)
    with pytest.raises(
        UserError, match=r"organ 'gut' is held so loosely that its slowest motion takes \d+ s: .*--fixed"
    ):
        check_pace("gut", 0.99 * slowest)


def test_an_organ_that_rests_under_fewer_than_half_of_the_loads_is_refused():
    check_settled("gut", answers([1, 1, 0, 0]))
    with pytest.raises(UserError, match="organ 'gut' came to rest under 1 of 4 held-out loads only"):
        check_settled("gut", answers([1, 0, 0, 0]))
