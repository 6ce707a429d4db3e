"""The benchmark of contact sets: every pair of tools really touches, and the figures are those of the sets."""

import numpy as np

from helpers.scenes import kidney
from tissue_sim.bench.contact import pairs, pressed, text
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


def test_text_tells_whether_the_bound_is_met():
    row = {"tools": "two spheres of 5 mm", "p50_us": 100.0, "p99_us": 500.0, "points": 50, "sets": 9, "fcl_asked": 8}
    found = {"rows": [row | {"largest_force_n": 0.5}], "limit_us": 400.0, "met": False, "noise": 1.0}
    assert "500 us (<= 400 us) missed" in text(found)


def test_file_that_is_no_organ_is_refused(tmp_path, capsys):
    assert main(["bench", "contact", str(tmp_path / "none.npz")]) == 2
    assert "none.npz" in capsys.readouterr().err
