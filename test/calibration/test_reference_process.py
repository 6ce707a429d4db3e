"""The finite-element body beside the fit: the same answers, reported one by one; its failures; its end."""

from concurrent.futures import wait
from dataclasses import replace
from threading import Event, Thread

import numpy as np
import pytest

from helpers.patience import LIMIT, wait_for
from helpers.scenes import ball
from tissue_sim.calibration import reference_process as background
from tissue_sim.calibration.cases import held_out_cases
from tissue_sim.calibration.checkpoint import Checkpoint
from tissue_sim.calibration.dynamics import Steps, lowest_frequencies, release
from tissue_sim.calibration.evaluation import RELEASE_STEP, RELEASE_TIME
from tissue_sim.calibration.fem import Body
from tissue_sim.calibration.inertia import MODES
from tissue_sim.calibration.reference_process import Reference
from tissue_sim.calibration.remote import Remote
from tissue_sim.errors import UserError

RATE = 40.0  # 1/s

for library in ("skfem", "netgen", "joblib", "threadpoolctl"):
    pytest.importorskip(library)


def reference_of(organ, folder, cases):
    reference = Reference(organ, Checkpoint(folder, {}), cases.force)
    reference.settle(cases, lambda _: (cases.force[0], 5), RATE)
    return reference


@pytest.mark.extended
def test_answers_are_those_of_the_body_and_are_kept(tmp_path):
    organ = ball(1)
    cases = held_out_cases(organ, 2, 0).scaled(np.array([0.1, 0.2]))
    reference = reference_of(organ, tmp_path, cases)
    steps, body = [], Body(organ)
    try:
        linear, found = reference.linear(), reference.answer(body, lambda: steps.append(1))
        motion = reference.motion()
    finally:
        reference.stop()
    assert len(steps) == 2
    np.testing.assert_allclose(linear["held_out"], body.settle_linear(cases.force), atol=1e-12)
    np.testing.assert_allclose(linear["frequencies"], lowest_frequencies(body, MODES), rtol=1e-6)
    settled = list(body.settle_many(cases.force))
    np.testing.assert_allclose(found.displacement, [one.displacement for one in settled], atol=1e-9)
    np.testing.assert_allclose(found.volume, [one.volume_change for one in settled], atol=1e-9)
    np.testing.assert_array_equal(found.converged, 1.0)
    wanted = release(body, cases.force[0], Steps(RELEASE_TIME, RELEASE_STEP), RATE, [5])
    np.testing.assert_allclose(motion["displacement"], wanted.displacement[:, 0], atol=1e-9)
    again = reference_of(replace(organ, poisson_ratio=0.5), tmp_path, cases)  # which would fail
    np.testing.assert_array_equal(again.answer(body, lambda: None).displacement, found.displacement)
    np.testing.assert_array_equal(again.motion()["displacement"], motion["displacement"])
    again.stop()


def test_what_goes_wrong_there_is_raised_here(tmp_path):
    organ = ball(1)
    reference = reference_of(replace(organ, poisson_ratio=0.5), tmp_path, held_out_cases(organ, 2, 0))
    try:
        with pytest.raises(UserError, match="Poisson's ratio"):
            reference.linear()
    finally:
        reference.stop()


@pytest.mark.extended
def test_groups_are_the_same_bits_whichever_process_settles_them(tmp_path, monkeypatch):
    """One process settles both groups, or this one takes the last while the other is kept waiting."""
    from threadpoolctl import threadpool_limits

    monkeypatch.setattr(background, "GROUP", 1)
    organ = ball(1)
    cases, body = held_out_cases(organ, 2, 0).scaled(np.array([0.1, 0.2])), Body(organ)
    found, own = [], Event()

    class Waiting(Remote):
        def call(self, method, *arguments):
            if method == "begin":
                assert own.wait(LIMIT)
            return super().call(method, *arguments)

    for kind in (Remote, Waiting):
        monkeypatch.setattr(background, "Remote", kind)
        reference = reference_of(organ, tmp_path / kind.__name__, cases)
        try:
            with threadpool_limits(1):
                if kind is Remote:
                    wait([reference._answer], LIMIT)
                found.append(reference.answer(body, own.set))
        finally:
            own.set()
            reference.stop()
    assert found[0].displacement.any()
    for alone, shared in zip(*found, strict=True):
        np.testing.assert_array_equal(alone, shared)


def test_stop_ends_what_is_under_way_and_keeps_nothing_of_it(tmp_path):
    organ = ball(1)
    reference = reference_of(organ, tmp_path, held_out_cases(organ, 2000, 0))
    reference.stop()
    kept = Checkpoint(tmp_path, {})
    for name in ("linear-held-out", "held-out", "release"):
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
