"""The comparison of local regions with the whole model."""

import json

import numpy as np
import pytest

from helpers.scenes import kidney
from tissue_sim.bench.region import SMALL, WHOLE_NONLINEAR, measure, off, summary
from tissue_sim.cli import main


@pytest.fixture(scope="module")
def cases():
    return measure(kidney(), 2)


def test_modal_region_keeps_its_bounds_and_frozen_is_far_off(cases):
    found = summary(cases)
    assert found["ok"]
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
    assert not summary(worse)["ok"]
    assert not summary([case._replace(settled=False) for case in cases])["ok"]


def test_error_is_relative():
    assert off(np.array([1.1, 0.0]), np.array([1.0, 0.0])) == pytest.approx(10.0)


def test_command_writes_json(capsys):
    assert main(["bench", "region", "--patches", "1", "--json", "--check"]) == 0
    assert json.loads(capsys.readouterr().out)["ok"]


def test_wrong_number_of_patches_is_one_line(capsys):
    assert main(["bench", "region", "--patches", "0"]) == 2
    assert "--patches 0" in capsys.readouterr().err
