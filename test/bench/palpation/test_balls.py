"""Balls at nodes, on edges, in triangles, and sliding: what the bounds say, and which options are refused."""

import json

import numpy as np
import pytest

from tissue_sim.bench.palpation import presses
from tissue_sim.bench.palpation.balls import as_json, parse_radii, text
from tissue_sim.bench.palpation.presses import Pressed
from tissue_sim.bench.palpation.slides import SlidingPress
from tissue_sim.cli import main
from tissue_sim.identification.places import KINDS


def pressed_of(radius, kind, *off):
    reference = np.array([0.1, 0.2, 0.4])
    return Pressed(radius, 0, kind, np.array([0.3, 0.5, 0.8]), (1.0 + 0.01 * np.array(off)) * reference, reference)


def test_bounds_take_the_worst_of_their_radii_and_leave_out_what_did_not_settle():
    pressed = [pressed_of(radius, kind, -9.0, 1.0, 2.0) for radius in (0.5, 2.0) for kind in KINDS]
    pressed[-1].reference[1:] = np.nan
    slid = [
        SlidingPress(0.5, 0, 0.6, 0.1, 30.0, 1e-3),
        SlidingPress(2.0, 0, 0.6, 0.1, 4.0, 1e-3),
        SlidingPress(2.0, 1, 0.6, 0.1, 6.0, 1e-3),
    ]
    found = as_json(pressed, slid)
    assert [bound["met"] for bound in found["bounds"]] == [False, True, False]
    assert [bound["value"] for bound in found["bounds"]] == pytest.approx([9.0, 9.0, 6.0])
    last = found["radii"][1]["triangle"]
    assert (last["compared"], last["unsettled"]) == (1, 2)
    shown = text(found | {"organ": "egg", "edge_m": 0.004, "places": 2})
    assert "-9.0 %" in shown
    assert "did not converge 2 times" in shown
    assert json.loads(json.dumps(found, allow_nan=False)) == found
    assert [bound["met"] for bound in as_json([], [])["bounds"]] == [None] * 3


@pytest.mark.parametrize(
    ("given", "what"),
    [
        (["--radii", "1"], "need --places"),
        (["--slab"], "need --places"),
        (["--places", "0"], "outside 1..100"),
        (["--places", "1", "--radii", "one"], "are not numbers"),
        (["--places", "1", "--radii", "0.01"], "outside 0.2..5"),
        (["organ.npz", "--places", "1", "--slab"], "choose one"),
    ],
)
def test_what_cannot_be_pressed_is_refused(given, what, capsys):
    assert main(["bench", "palpation", *given]) == 2
    assert what in capsys.readouterr().err


def test_radii_are_read():
    assert parse_radii("0.5,2") == (0.5, 2.0)
    assert parse_radii(None)[0] == 0.5


@pytest.mark.extended
def test_the_whole_of_it_runs_on_an_organ(organ, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(presses, "DEPTHS", np.array([0.4]))
    organ.save(tmp_path / "ball.npz")
    given = [str(tmp_path / "ball.npz"), "--places", "1", "--radii", "2", "--json", str(tmp_path / "found.json")]
    assert main(["bench", "palpation", *given]) == 0
    found = json.loads((tmp_path / "found.json").read_text())
    assert len(found["presses"]) == 3
    assert [one["friction"] for one in found["slides"]] == [0.6, 0.0]
    assert found["radii"][0]["node"]["unsettled"] == 0
    assert "bound" in capsys.readouterr().out
