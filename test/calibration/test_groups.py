"""The paper's search over a factor for each group."""

from itertools import pairwise

import numpy as np

from helpers.scenes import ball
from helpers.springs_of_ball import MODEL, ORGAN, SPRINGS, START, linear_answers
from tissue_sim.calibration.cases import fit_cases
from tissue_sim.calibration.fit import Misfit
from tissue_sim.calibration.groups import GROUPS, group_of, search
from tissue_sim.model.elasticity.assembly import assemble
from tissue_sim.organ.organ import SpringKind


def test_groups_name_the_kinds_of_springs():
    organ = ball(2)
    model = assemble(organ)
    group = group_of(organ, model)
    axial, angular, pulls = np.split(group, np.cumsum([len(model.spring_first), len(model.angular_nodes)]))
    assert np.all((axial == 0) == (organ.spring_kind == SpringKind.EDGE))
    assert np.all((axial == 2) == (organ.spring_kind == SpringKind.SKELETON))
    assert set(angular) == {3}
    assert set(pulls) == {4}
    assert len(GROUPS) == 5


def test_factors_on_groups_are_found():
    group = group_of(ORGAN, MODEL)
    factors = np.array([2.0, 0.5, 3.0, 1.0, 0.1])
    force = fit_cases(ORGAN, 16, 0)
    misfit = Misfit(SPRINGS, force, linear_answers(START * factors[group], force))
    before = misfit.evaluate(START).error.mean()
    seen = []
    found = search(START, group, misfit, 200, lambda count, error: seen.append((count, np.mean(error**2))))
    after = misfit.evaluate(found).error.mean()
    assert before > 0.1
    assert after < 0.15 * before
    assert len(seen) <= 200
    assert all(later <= sooner + 1e-12 for (_, sooner), (_, later) in pairwise(seen))


def test_the_search_never_makes_it_worse():
    group = group_of(ORGAN, MODEL)
    force = fit_cases(ORGAN, 10, 0)
    misfit = Misfit(SPRINGS, force, linear_answers(START, force))
    np.testing.assert_array_equal(search(START, group, misfit, 40), START)
