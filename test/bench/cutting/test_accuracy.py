"""The comparison of cut organs with finite elements: what planted errors do to its figures, and what it prints."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from helpers.bars import bar
from tissue_sim.bench.cutting import accuracy, reference
from tissue_sim.bench.cutting.cut_body import SAMPLES
from tissue_sim.bench.cutting.cuts import CUTS, OPENING, Cut, loads_of, placed
from tissue_sim.bench.cutting.modelled import Modelled
from tissue_sim.bench.cutting.organs import kidney, makers
from tissue_sim.bench.cutting.reference import (
    OPENED,
    Reference,
    force_for,
    key_of,
    packed,
    patch_force,
    stored_table,
    unpacked,
)
from tissue_sim.bench.cutting.reference import reference_of as find_reference
from tissue_sim.cli import main
from tissue_sim.errors import UserError
from tissue_sim.model.cutting import crossing
from tissue_sim.organ.surfaces.sizing import mean_edge

CUT = Cut("bar", "flat", 0.03, 0.012, (0.3, 0.05, 1.0), 90.0)
FORCE = 0.004  # N
STILL = ("both lips together", "press far away")


@pytest.fixture(scope="module")
def organ():
    return bar(12, 0.01, 4)


def edge_of(organ):
    return mean_edge(organ.surface_positions, organ.surface_triangles)


@pytest.fixture(scope="module")
def own(organ):
    """A reference that the model itself has made."""
    place = placed(organ, CUT)
    loads = loads_of(organ, place)
    chosen = [loads.names.index(name) for name in (OPENING, *STILL)]
    force = FORCE * loads.force[chosen]
    opened, whole = Modelled(organ, place), Modelled(organ, None)
    cut, uncut = ([body.settle(one) for one in force] for body in (opened, whole))
    moved = np.array([one.answer.displacement for one in cut])
    size = patch_force(force[0])
    return Reference(
        names=(OPENING, *STILL),
        force=force,
        uncut=np.array([one.answer.displacement for one in uncut]),
        free=moved,
        displacement=moved,
        opening=np.array([one.answer.opening for one in cut]),
        closed=np.array([0.0, 1e-3, 0.0]),
        left=np.zeros(3),
        settled=np.ones(3, dtype=bool),
        released=np.array([one.potential - other.potential for one, other in zip(uncut, cut, strict=True)]),
        off=np.full(3, 0.1),
        gap_off=np.full(3, 0.2),
        opening_force=opened.opening_force(force[0], size, OPENED),
        nodes=np.array([100, 200]),
    )


@pytest.fixture(scope="module")
def same(organ, own):
    return accuracy.compared(organ, CUT, own, edge_of(organ))


def test_the_model_agrees_with_itself(same):
    assert same.settled.all()
    for figures in (same.error, same.gap, same.uncut, same.free_error):
        np.testing.assert_allclose(figures, 0.0, atol=1e-6)
    assert same.force == pytest.approx(0.0, abs=1e-6)
    assert same.energy == pytest.approx(0.0, abs=1e-3)
    assert same.touch.tolist() == [False, True, False]


def test_a_cut_that_is_left_out_moves_the_figures(same):
    """Column `left out` is this fault: the uncut organ under the loads of the cut one."""
    assert same.left_out[0] > 20.0


def test_a_front_that_is_not_moved_moves_the_figures(organ, own, monkeypatch):
    monkeypatch.setattr(crossing, "ADVANCE", 0.0)
    found = accuracy.compared(organ, CUT, own, edge_of(organ))
    assert found.error[0] > 10.0
    assert found.gap[0] > 10.0
    assert found.force > 10.0


def test_a_modulus_that_is_a_tenth_too_large_moves_the_figures(organ, own):
    stiff = replace(organ, cell_mu=1.1 * organ.cell_mu, cell_lambda=1.1 * organ.cell_lambda)
    found = accuracy.compared(stiff, CUT, own, edge_of(organ))
    np.testing.assert_allclose(found.error, 100.0 / 11.0, atol=2.0)
    assert found.gap[0] == pytest.approx(100.0 / 11.0, abs=2.0)
    assert found.force == pytest.approx(10.0, abs=2.0)


def test_bounds_take_all_loads_and_rows_keep_apart_what_touches(same):
    worse = same._replace(error=np.array([3.0, 30.0, 6.0]), gap=np.array([10.0, 20.0, 60.0]), force=-12.0)
    found = accuracy.as_json([worse], ["liver is left out: no data"])
    value = {bound["name"]: (bound["value"], bound["met"]) for bound in found["bounds"]}
    assert value["displacement, lips apart: mean"] == (4.5, False)
    assert value["displacement, lips apart: worst"] == (6.0, True)
    assert value["opening of the lips, lips apart: mean"] == (35.0, False)
    assert value["displacement, lips touch: mean"] == (30.0, False)
    assert value["force that opens a cut by 5 mm, worst cut"] == (12.0, False)
    rows = {row["name"]: row for row in found["rows"]}
    assert rows["all"]["apart"]["mean_percent"] == 4.5
    assert rows["all"]["touch"]["worst_percent"] == 30.0
    assert [row["apart"]["loads"] + row["touch"]["loads"] for row in found["loads"]] == [1, 1, 1]
    assert json.loads(json.dumps(found, allow_nan=False)) == found
    text = accuracy.text(found)
    assert "liver is left out" in text
    assert text.count("missed") == 5
    assert "both lips together" in text


def test_what_has_not_settled_is_no_figure(same):
    lost = same._replace(settled=np.array([True, False, True]), force=np.nan)
    found = accuracy.as_json([lost], [])
    assert [found["rows"][0][key]["loads"] for key in ("apart", "touch")] == [2, 0]
    assert found["rows"][0]["not_settled"] == 1
    assert found["bounds"][-1]["met"] is None


def test_a_reference_is_stored_in_little_room(own):
    found = unpacked(packed(own))
    np.testing.assert_allclose(found.displacement, own.displacement, atol=3e-7)
    np.testing.assert_allclose(found.opening, own.opening, atol=3e-7)
    np.testing.assert_array_equal(found.force, own.force)
    assert found.names == own.names
    assert found.opening.shape == (3, SAMPLES, 3)


def test_a_force_is_found_for_an_opening():
    assert force_for(2.0, 0.7, lambda force: force + 0.3 * force**2) == pytest.approx(1.408, rel=0.01)
    assert np.isnan(force_for(2.0, 0.7, lambda force: None))


def test_the_table_that_ships_is_of_the_kidney_that_ships():
    stored, organ = stored_table(), kidney()
    known = {key_of(organ, cut): cut for cut in CUTS if cut.organ == "kidney"}
    keys = {name.split("/")[0] for name in stored}
    assert keys
    assert keys <= set(known)
    for key in keys:
        found = find_reference(organ, known[key], stored)
        assert len(found.names) == 9
        assert found.settled.sum() >= 8
        assert found.off.max() < 2.0
        opened = found.names.index(OPENING)
        lost = np.linalg.norm(found.uncut - found.displacement, axis=(1, 2))
        assert lost[opened] > 0.2 * np.linalg.norm(found.displacement[opened]), "the cut shows"


def test_without_the_data_the_liver_is_left_out():
    with pytest.raises(UserError, match="--data FOLDER"):
        makers(None)["liver"]()
    found, skipped = accuracy.measure(makers(Path("/nowhere")), [cut for cut in CUTS if cut.organ == "liver"])
    assert not found
    assert len(skipped) == 1
    assert accuracy.as_json(found, skipped)["bounds"][0]["met"] is None


@pytest.mark.parametrize(
    "given", [["--remake"], ["--data", "x"], ["--organs", "slab"], ["--refine"], ["--only", "flat"]]
)
def test_options_of_the_comparison_need_it(given, capsys):
    assert main(["bench", "cut", *given]) == 2
    assert "needs --accuracy" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("given", "reason"),
    [
        (["--only", "straight"], "no cut has --only 'straight' in its name: kidney, flat 28 x 10"),
        (["--organs", "slab", "--remake"], "--remake is for the kidney's cuts"),
    ],
)
def test_cuts_that_there_are_not_are_refused(given, reason, capsys):
    assert main(["bench", "cut", "--accuracy", *given]) == 2
    assert reason in capsys.readouterr().err


def test_a_reference_that_is_made_anew_leaves_those_of_other_cuts(own, tmp_path, monkeypatch):
    asked = []
    monkeypatch.setattr(reference, "reference_of", lambda organ, cut, stored: asked.append(cut) or own)
    chosen, path = next(cut for cut in CUTS if cut.organ == "kidney"), tmp_path / "cut.npz"
    reference.remake(kidney(), path, [chosen])
    assert asked == [chosen]
    before, new = stored_table(), key_of(kidney(), chosen)
    with np.load(path) as made:
        assert sorted(made.files) == sorted(before)
        for name in made.files:
            if not name.startswith(new):
                np.testing.assert_array_equal(made[name], before[name])
        np.testing.assert_array_equal(made[f"{new}/force"], packed(own)["force"])
