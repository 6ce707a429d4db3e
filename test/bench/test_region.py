"""The comparison of local regions with the whole model."""

import json

import numpy as np
import pytest

from helpers.scenes import kidney
from tissue_sim.bench.region import SMALL, WHOLE_NONLINEAR, as_json, measure, off
from tissue_sim.cli import main


@pytest.fixture(scope="module")
def cases():
    return measure(kidney(), 2)


def is_met(cases):
    return [bound["met"] for bound in as_json(cases)["bounds"]]


def test_modal_region_keeps_its_bounds_and_frozen_is_far_off(cases):
    assert all(is_met(cases))
    assert len(cases) == 6
    for case in cases:
        assert case.frozen > 10.0 * case.modal
        assert case.modal < WHOLE_NONLINEAR
    assert max(case.dent for case in cases) > 2.9e-3
    # What is compared differs: under a small force the body is linear, under a large one it isn't.
    for case in cases:
        assert (case.linear < 1.5) == (case.force == SMALL)


def test_missed_bound_is_told(cases):
    worse = [case._replace(modal=2.0 * WHOLE_NONLINEAR) for case in cases]
    assert is_met(worse) == [True, True, False, True]
    assert is_met([cases[0]._replace(settled=False), *cases[1:]]) == [True, True, True, False]


def test_error_is_relative():
    assert off(np.array([1.1, 0.0]), np.array([1.0, 0.0])) == pytest.approx(10.0)


def test_command_writes_json(capsys):
    assert main(["bench", "region", "--patches", "1", "--json", "--check"]) == 0
    assert len(json.loads(capsys.readouterr().out)["cases"]) == 3


def test_wrong_number_of_patches_is_one_line(capsys):
    assert main(["bench", "region", "--patches", "0"]) == 2
    assert "--patches 0" in capsys.readouterr().err
