"""The comparison of local regions with the whole model."""

import json

import numpy as np
import pytest

from helpers.scenes import ball, ball_of_cells, kidney
from tissue_sim.bench.region import SMALL, WHOLE_NONLINEAR, as_json, measure, measure_sizes, off, places
from tissue_sim.cli import main
from tissue_sim.model.regions.region_tables import MAX_WHOLE_CELLS
from tissue_sim.model.simulation import Simulation


@pytest.fixture(scope="module", params=["springs", "cells"])
def cases(request):
    organ = ball(3)
    return measure(ball_of_cells() if request.param == "cells" else organ, 1)


def is_met(cases):
    return [bound["met"] for bound in as_json(cases, [])["bounds"]]


@pytest.mark.extended
def test_auto_keeps_its_bounds_by_handing_over_and_what_is_frozen_is_far_off(cases):
    assert all(is_met(cases))
    assert max(case.modal for case in cases) > max(case.auto for case in cases)
    for case in cases:
        assert case.auto == pytest.approx(0.0 if case.handed_over else case.modal, abs=0.1)
        assert not case.handed_over or case.force > SMALL
        assert case.frozen is None or case.frozen > 10.0 * case.modal
    assert any(case.handed_over for case in cases)
    assert max(case.dent for case in cases) == pytest.approx(6e-3, rel=0.05)
    # What is compared differs: under a small force the body is linear, under a large one it isn't.
    for case in cases:
        assert (case.linear < 1.5) == (case.force == SMALL)


@pytest.mark.extended
def test_missed_bound_is_reported(cases):
    worse = [case._replace(auto=2.0 * WHOLE_NONLINEAR) for case in cases]
    assert is_met(worse) == [True, False, True]
    assert is_met([cases[0]._replace(settled=False), *cases[1:]]) == [True, True, False]


def test_places_are_away_from_what_is_held_and_reach_the_ends():
    organ = kidney()
    found = places(Simulation(organ), 3)
    assert len(found) == len(set(found)) >= 6
    x = organ.surface_positions
    apart = np.linalg.norm(x[found][:, None] - x[organ.fixed], axis=2).min(axis=1)
    assert apart.min() > 0.01
    assert np.argmax(x[:, 2]) in found or np.argmin(x[:, 2]) in found


@pytest.mark.extended
def test_a_bean_is_timed_and_auto_goes_by_its_cells():
    (size,) = measure_sizes([80], 0.2)
    assert size.points == 80
    assert size.modal.median > 0.0
    assert 0.0 < min(size.small, size.dented) < 50.0
    assert size.auto == (size.cells > MAX_WHOLE_CELLS)


def test_error_is_relative():
    assert off(np.array([1.1, 0.0]), np.array([1.0, 0.0])) == pytest.approx(10.0)


@pytest.mark.extended
def test_command_writes_json(capsys, tmp_path):
    path = tmp_path / "ball.npz"
    ball_of_cells().save(path)
    assert main(["bench", "region", str(path), "--places", "0", "--json", "--check"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert len(found["cases"]) % 3 == 0
    assert found["sizes"] == []


@pytest.mark.parametrize(("option", "value"), [("--places", "-1"), ("--points", "5")])
def test_wrong_number_is_one_line(capsys, option, value):
    assert main(["bench", "region", option, value]) == 2
    assert f"{option} {value}" in capsys.readouterr().err
