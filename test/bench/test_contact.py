"""The benchmark of contact sets: every pair of tools really touches, and the figures are those of the sets."""

import numpy as np
import pytest

from helpers.scenes import kidney
from tissue_sim.bench.contact import Pressed, as_json, pairs, pressed, text
from tissue_sim.cli import main


def test_every_pair_presses_and_its_sets_are_counted(tmp_path):
    names = [name for name, _ in pairs(tmp_path)]
    assert len(set(names)) == len(names) == 6
    for name, tools in pairs(tmp_path)[:1] + pairs(tmp_path)[3:4]:
        found = pressed(kidney(), name, tools)
        assert found.force > 0.05
        assert found.points > 10
        assert found.asked > 0
        assert np.all(found.seconds > 0.0)


def test_bound_is_held_or_missed_by_the_first_pair():
    slow, quick = Pressed("slow", np.full(9, 5e-4), 50, 8, 9, 0.5), Pressed("quick", np.full(9, 3e-4), 50, 8, 9, 0.5)
    loop = np.full(100, 1e-4)
    assert [bound["met"] for bound in as_json([quick, slow], loop)["bounds"]] == [True]
    found = as_json([slow, quick], loop)
    assert [bound["met"] for bound in found["bounds"]] == [False]
    assert found["rows"][0]["of_fixed_loop"] == pytest.approx(5.0)
    shown = text(found)
    assert "slow, p99" in shown
    assert "missed" in shown


def test_file_that_is_no_organ_is_refused(tmp_path, capsys):
    assert main(["bench", "contact", str(tmp_path / "none.npz")]) == 2
    assert "none.npz" in capsys.readouterr().err
