"""Loads let fall at once, against the same ones raised."""

import json

import pytest

from helpers.scenes import ball, ball_of_cells
from tissue_sim.bench.fall import JUDGED, as_json, measure, text
from tissue_sim.cli import main


@pytest.fixture(scope="module")
def ball_with_cells():
    organ = ball_of_cells()
    return organ, measure(organ, 3, (0.2, 0.4))


def met(found):
    return [bound["met"] for bound in as_json(found)["bounds"]]


@pytest.mark.extended
def test_cells_come_to_the_shape_of_the_raised_load(ball_with_cells):
    _, found = ball_with_cells
    assert met(found) == [True, True, True]
    assert [one.kind for one in found] == ["bump", "bump", "sharp"] * 2
    for gentle, hard in zip(found[:3], found[3:], strict=True):
        assert hard.newton == pytest.approx(2.0 * gentle.newton)
        assert 1e-3 < gentle.deepest < hard.deepest


@pytest.mark.extended
def test_a_dent_that_stays_is_seen():
    """Springs that a fall has turned over hold the organ in another shape than the raised load does."""
    (one, *_) = [one for one in measure(ball(3), 6, (1.0,)) if one.turned]
    assert one.off > 0.05
    assert one.faults == 0
    assert met([one._replace(traction=JUDGED)]) == [False, False, one.settled]


def test_text_has_a_row_for_each_traction(ball_with_cells):
    organ, found = ball_with_cells
    lines = text(organ, as_json(found)).splitlines()
    assert [line.split()[0] for line in lines[3:5]] == ["0.2", "0.4"]


@pytest.mark.extended
def test_command_writes_json(capsys, tmp_path):
    path = tmp_path / "ball.npz"
    ball_of_cells().save(path)
    assert main(["bench", "fall", str(path), "--loads", "3", "--json", "--check"]) == 0
    assert len(json.loads(capsys.readouterr().out)["loads"]) == 3 * 4


def test_too_few_loads_are_one_line(capsys):
    assert main(["bench", "fall", "--loads", "2"]) == 2
    assert "--loads 2 is outside 3..1000" in capsys.readouterr().err
