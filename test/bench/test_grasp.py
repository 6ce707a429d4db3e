"""Jaws that slip from organs and hold them: the figures, and faults that they show."""

import json

import numpy as np
import pytest

from helpers.scenes import ball_of_cells
from tissue_sim.bench import grasp
from tissue_sim.bench.grasp import FRICTION, MOST_OFF, Nip, as_json, grasped, gripper, text
from tissue_sim.cli import main
from tissue_sim.organ.organ import Organ

BOUNDS = "slip force against Coulomb's, worst organ", "creep in the hold, worst organ"


@pytest.fixture(scope="module")
def kidney():
    return Organ.shipped("kidney")


@pytest.fixture(scope="module")
def found(kidney):
    return grasped(kidney, 1.0)


def met(*found):
    return {bound["name"]: bound["met"] for bound in as_json(found)["bounds"]}


def test_jaws_slip_at_coulombs_force_and_hold_below_it(found):
    print(found)
    assert met(found) == dict.fromkeys(BOUNDS, True)
    assert found.points > 10
    assert 0.4 < found.held < 0.8
    assert found.normal > 0.1


@pytest.mark.extended
def test_friction_that_is_wrong_by_a_tenth_is_seen(kidney, found):
    wrong = grasped(kidney, 0.1, 1.1 * FRICTION)
    assert wrong.off - found.off == pytest.approx(0.1, abs=0.03)
    assert 100.0 * abs(wrong.off) > MOST_OFF
    assert met(found, wrong)[BOUNDS[0]] is False, "the worst organ counts"


@pytest.mark.extended
def test_creep_is_seen(kidney, monkeypatch):
    """Jaws that lose a tenth of their friction in every look let the tissue creep."""
    lead = Nip.lead

    def losing(self, place, angle, ticks):
        if ticks == 100:
            self.scene.simulation.settings.friction *= 0.5
        lead(self, place, angle, ticks)

    monkeypatch.setattr(Nip, "lead", losing)
    crept = grasped(kidney, 0.5)
    assert met(crept)[BOUNDS[1]] is False


def test_text_has_a_row_for_each_organ_and_the_bounds(found):
    lines = text(as_json([found, found._replace(organ="other", off=-0.07)])).splitlines()
    assert [line.split()[0] for line in lines[3:5]] == [found.organ, "other"]
    assert lines[-2].split()[-1] == "missed"


@pytest.mark.extended
def test_command_writes_json(capsys, monkeypatch, found):
    monkeypatch.setattr(grasp, "grasped", lambda organ, seconds: found._replace(organ=organ.name, seconds=seconds))
    assert main(["bench", "grasp", "--hold", "2", "--json", "--check"]) == 0
    names = [one["organ"] for one in json.loads(capsys.readouterr().out)["organs"]]
    assert len(set(names)) == len(grasp.ORGANS)


def test_what_cannot_be_grasped_is_one_line(capsys, tmp_path):
    path = tmp_path / "ball.npz"
    small = ball_of_cells()
    Organ.save(small, path)
    assert main(["bench", "grasp", str(path), "--hold", "0"]) == 2
    assert "--hold 0 is outside 0.1..3600 s" in capsys.readouterr().err
    assert np.isfinite(gripper().length)
