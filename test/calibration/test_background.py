"""The finite-element body beside the fit: the same answers, told one by one; its failures; its end."""

from dataclasses import replace

import numpy as np
import pytest

from helpers.scenes import ball
from tissue_sim.calibration.background import Reference, Task
from tissue_sim.calibration.cases import fit_cases
from tissue_sim.calibration.checkpoint import Checkpoint
from tissue_sim.calibration.fe_mesh import Grading
from tissue_sim.calibration.fem import Body
from tissue_sim.errors import UserError

COARSE = Grading(clamp=0)

for library in ("skfem", "netgen", "joblib"):
    pytest.importorskip(library)


def test_answers_are_those_of_the_body_and_are_kept(tmp_path):
    organ = ball(2)
    cases = fit_cases(organ, 2, 0).scaled(np.array([0.1, 0.2]))
    reference = Reference(
        organ, Checkpoint(tmp_path, {}), {"some": Task(cases, COARSE), "none": Task(cases.chosen([]))}
    )
    told = []
    try:
        found = reference.answer("some", lambda: told.append(1))
        assert len(reference.answer("none", lambda: told.append(1)).converged) == 0
    finally:
        reference.stop()
    assert len(told) == 2
    settled = list(Body(organ, grading=COARSE).settle_many(cases.force))
    np.testing.assert_allclose(found.displacement, [one.displacement for one in settled], atol=1e-9)
    np.testing.assert_allclose(found.volume, [one.volume_change for one in settled], atol=1e-9)
    np.testing.assert_array_equal(found.converged, 1.0)
    again = Reference(replace(organ, poisson_ratio=0.5), Checkpoint(tmp_path, {}), {"some": Task(cases, COARSE)})
    np.testing.assert_array_equal(again.answer("some", lambda: None).displacement, found.displacement)
    again.stop()


def test_what_goes_wrong_there_is_raised_here(tmp_path):
    organ = ball(2)
    cases = fit_cases(organ, 2, 0)
    reference = Reference(replace(organ, poisson_ratio=0.5), Checkpoint(tmp_path, {}), {"some": Task(cases, COARSE)})
    try:
        with pytest.raises(UserError, match="Poisson's ratio"):
            reference.answer("some", lambda: None)
    finally:
        reference.stop()


def test_stop_ends_what_is_under_way_and_keeps_nothing_of_it(tmp_path):
    organ = ball(2)
    cases = fit_cases(organ, 2, 0)
    reference = Reference(organ, Checkpoint(tmp_path, {}), {"some": Task(cases), "more": Task(cases)})
    reference.stop()
    kept = Checkpoint(tmp_path, {})
    for name in ("some", "more"):
        assert "x" in kept.remember(name, lambda: {"x": np.zeros(1)})
