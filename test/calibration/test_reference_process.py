"""The finite-element body beside the fit: the same answers, told one by one; its failures; its end."""

from dataclasses import replace
from threading import Event, Thread

import numpy as np
import pytest

from helpers.patience import LIMIT, wait_for
from helpers.scenes import ball
from tissue_sim.calibration import reference_process as background
from tissue_sim.calibration.cases import held_out_cases
from tissue_sim.calibration.checkpoint import Checkpoint
from tissue_sim.calibration.dynamics import release
from tissue_sim.calibration.evaluation import RELEASE_STEP, RELEASE_TIME
from tissue_sim.calibration.fem import Body
from tissue_sim.calibration.reference_process import Reference
from tissue_sim.errors import UserError

RATE = 40.0  # 1/s

for library in ("skfem", "netgen", "joblib"):
    pytest.importorskip(library)


def reference_of(organ, folder, cases):
    return Reference(organ, Checkpoint(folder, {}), cases, lambda _: (cases.force[0], 5), RATE)


@pytest.mark.extended
def test_answers_are_those_of_the_body_and_are_kept(tmp_path):
    organ = ball(1)
    cases = held_out_cases(organ, 2, 0).scaled(np.array([0.1, 0.2]))
    reference = reference_of(organ, tmp_path, cases)
    told = []
    try:
        found, motion = reference.answer(lambda: told.append(1)), reference.motion()
    finally:
        reference.stop()
    assert len(told) == 2
    body = Body(organ)
    settled = list(body.settle_many(cases.force))
    np.testing.assert_allclose(found.displacement, [one.displacement for one in settled], atol=1e-9)
    np.testing.assert_allclose(found.volume, [one.volume_change for one in settled], atol=1e-9)
    np.testing.assert_array_equal(found.converged, 1.0)
    wanted = release(body, cases.force[0], RELEASE_TIME, RELEASE_STEP, RATE, [5])
    np.testing.assert_allclose(motion["displacement"], wanted.displacement[:, 0], atol=1e-9)
    again = reference_of(replace(organ, poisson_ratio=0.5), tmp_path, cases)  # which would fail
    np.testing.assert_array_equal(again.answer(lambda: None).displacement, found.displacement)
    np.testing.assert_array_equal(again.motion()["displacement"], motion["displacement"])
    again.stop()


def test_what_goes_wrong_there_is_raised_here(tmp_path):
    organ = ball(1)
    reference = reference_of(replace(organ, poisson_ratio=0.5), tmp_path, held_out_cases(organ, 2, 0))
    try:
        with pytest.raises(UserError, match="Poisson's ratio"):
            reference.answer(lambda: None)
    finally:
        reference.stop()


def test_stop_ends_what_is_under_way_and_keeps_nothing_of_it(tmp_path):
    organ = ball(1)
    reference = reference_of(organ, tmp_path, held_out_cases(organ, 2000, 0))
    reference.stop()
    kept = Checkpoint(tmp_path, {})
    for name in ("held-out", "release"):
        assert "x" in kept.remember(name, lambda: {"x": np.zeros(1)})


def test_a_process_that_starts_while_all_is_stopped_is_ended(tmp_path, monkeypatch):
    starting, may_start, closed = Event(), Event(), Event()

    class Starting:
        def __init__(self, *_):
            starting.set()
            may_start.wait(LIMIT)

        def call(self, *_):
            raise AssertionError("asked after the end")

        def close(self):
            closed.set()

    monkeypatch.setattr(background, "Remote", Starting)
    organ = ball(1)
    reference = reference_of(organ, tmp_path, held_out_cases(organ, 2, 0))
    assert starting.wait(LIMIT)
    stopping = Thread(target=reference.stop)
    stopping.start()
    wait_for(lambda: reference._stopped)
    may_start.set()
    stopping.join(LIMIT)
    assert not stopping.is_alive()
    assert closed.is_set()
