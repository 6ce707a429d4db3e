"""Which held-out loads tell nothing of an organ."""

import numpy as np
import pytest

from tissue_sim.calibration.calibrate import BUCKLING, POKE, _near_buckling, _poke, _usable
from tissue_sim.calibration.cases import Cases
from tissue_sim.calibration.evaluation import Answer
from tissue_sim.errors import UserError


def test_loads_near_buckling_are_named_with_how_far_they_go():
    linear = np.zeros((5, 3, 3))
    linear[:, 1, 2] = 0.010  # m
    factor = np.array([1.0, 1.01 * BUCKLING, 0.99 / BUCKLING, 0.99 * BUCKLING, 9.0])
    wanted = Answer(linear * factor[:, None, None], np.zeros(5), np.array([1.0, 1.0, 1.0, 1.0, 0.0]), np.ones(5))
    kinds = ["bump", "bump", "pulling bump", "sharp", "sharp"]
    cases = Cases(np.random.default_rng(0).normal(size=(5, 3, 3)), [np.array([node]) for node in range(10, 15)], kinds)
    found = _near_buckling(cases, linear, wanted)
    assert list(found) == [1, 2]  # the last one's finite elements did not settle
    assert found[1] == "bump at node 11, 10.0 mm linear, 30.3 mm nonlinear"
    assert found[2] == "pulling bump at node 12, 10.0 mm linear, 3.3 mm nonlinear"
    assert list(_near_buckling(cases, linear, wanted, stiffens=True)) == [1]
    kept = _usable(cases, linear, wanted)
    np.testing.assert_array_equal(kept, [0, 3])
    wanted.displacement[0, 1, 2] = 0.008
    cases.centre[:] = [np.array([1])] * 5
    force, node = _poke(cases, wanted, kept, POKE)  # the bump, though the sharp one were as near
    assert node == 1
    np.testing.assert_allclose(force, cases.force[0] * POKE / 0.008)
    with pytest.raises(UserError, match="converge under none"):
        _poke(cases, wanted, kept[:0], POKE)
