"""Two tools that squeeze the organ: what is measured of it, and what the bounds say."""

import json
from dataclasses import replace

import numpy as np
import pytest

from helpers.scenes import ball, ball_of_cells
from tissue_sim.bench import pinch, pinch_reference
from tissue_sim.bench import pinch_tools as two_tools
from tissue_sim.cli import main
from tissue_sim.contact.tools import Tool
from tissue_sim.errors import UserError
from tissue_sim.organ.cell_mesh import with_cells
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.shipped import shipped_organ
from tissue_sim.organ.topology import assemble_like

SPHERES = [Tool("left", radius=0.005), Tool("right", radius=0.005)]


@pytest.fixture(scope="module")
def gentle():
    organ = with_cells(assemble_like(ball(2), interior_atoms=60))
    return two_tools.pinched(organ, "spheres", SPHERES, 0, 0.2)


def test_a_gentle_pinch_has_a_force_and_leaves_nothing(gentle):
    assert gentle.width == pytest.approx(0.06, rel=0.1)
    assert gentle.force > 0.05
    assert 0.0 < gentle.least < 1.0
    assert gentle.held_turned == gentle.left_turned == gentle.faults == 0
    assert gentle.left < 1e-4
    assert len(gentle.seconds) == two_tools.CLOSING + two_tools.HOLDING + two_tools.OPENING
    assert gentle.seconds.min() >= 0.0


def test_bounds_take_the_worst_and_the_text_names_every_pinch(gentle):
    bad = gentle._replace(tools="jaws", axis=2, fraction=0.4, held_turned=3, left=2e-3, seconds=np.full(5, 1e-3))
    hard = bad._replace(fraction=0.6, held_turned=9)
    found = pinch.as_json([gentle, bad, hard], np.full(10, 5e-5))
    value = {bound["name"]: (bound["value"], bound["met"]) for bound in found["bounds"]}
    assert value["inverted cells, held at 20 and 40 %"] == (3, False)
    assert value["inverted cells long after"] == (0, True)
    assert value["remaining deformation"] == (2.0, False)
    assert value["tick, p99 of the worst"][0] >= 1e3
    assert json.loads(json.dumps(found)) == found
    text = pinch.text(found)
    assert text.count("jaws") == 2
    assert "missed" in text


def test_every_pair_is_of_two_tools(tmp_path):
    found = two_tools.pairs(tmp_path)
    assert len(found) == 3
    assert all(len(tools) == 2 for _, tools in found)


# finite elements -----------------------------------------------------------------------------------
@pytest.fixture
def quick(monkeypatch):
    """One shallow pinch along each axis."""
    monkeypatch.setattr(pinch_reference, "FRACTIONS", (0.1,))
    monkeypatch.setattr(pinch_reference, "SPEED", 0.1)
    monkeypatch.setattr(pinch_reference, "CLEAR", 0.001)


def table_of(organ, rows):
    return {"organ": organ.name, "fits": pinch_reference.fits(organ), "rows": rows}


def row_of(axis, force, fraction=10.0):
    return {"axis": axis, "share_percent": fraction, "force_n": force, "least_volume": 0.8}


@pytest.mark.usefixtures("quick")
def test_a_stiffer_cell_law_and_a_wrong_force_move_the_figure():
    organ = ball_of_cells()
    own = [row_of("xyz"[axis], pinch_reference.slowly(organ, axis)[0][0].tolist()) for axis in range(3)]

    def off(organ):
        return [one.off for one in pinch_reference.measure(organ, table_of(organ, own))]

    assert off(organ) == [0.0] * 3, "the same twice"
    stiffer = replace(organ, cell_mu=1.1 * organ.cell_mu, cell_lambda=1.1 * organ.cell_lambda)
    assert min(off(stiffer)) > 3.0
    own = [row | {"force_n": (np.array(row["force_n"]) / 1.1).tolist()} for row in own]
    assert off(organ) == pytest.approx([10.0] * 3, rel=1e-6)


def test_the_table_that_ships_is_of_the_kidney_that_ships():
    table = pinch_reference.read(pinch_reference.stored(), Organ.load(shipped_organ()))
    assert [row["axis"] for row in table["rows"]] == ["x", "x", "y", "y", "z", "z"]


def test_a_table_of_another_organ_or_of_other_pinches_is_refused(tmp_path):
    path, organ = tmp_path / "pinch.json", ball_of_cells()
    rows = [row_of(axis, np.ones((2, 3)).tolist(), fraction) for axis in "xyz" for fraction in (20.0, 40.0)]
    path.write_text(json.dumps(table_of(organ, rows)))
    assert pinch_reference.read(path, organ)["rows"] == rows
    with pytest.raises(UserError, match="another surface, clamp or material"):
        pinch_reference.read(path, replace(organ, youngs_modulus=1.01 * organ.youngs_modulus))
    path.write_text(json.dumps(table_of(organ, rows[1:])))
    with pytest.raises(UserError, match="other pinches"):
        pinch_reference.read(path, organ)
    path.write_text("[]")
    with pytest.raises(UserError, match="is not a table"):
        pinch_reference.read(path, organ)
    with pytest.raises(UserError, match="cannot read"):
        pinch_reference.read(tmp_path / "none.json", organ)


@pytest.mark.parametrize(
    ("given", "what"),
    [
        (["ORGAN", "--remake"], "name it with --reference"),
        (["ORGAN", "--remake", "--reference", "x.npz"], "would overwrite"),
    ],
)
def test_a_table_is_written_nowhere_else(given, what, tmp_path, capsys):
    ball_of_cells().save(tmp_path / "ball.npz")
    assert main(["bench", "pinch", *(str(tmp_path / "ball.npz") if one == "ORGAN" else one for one in given)]) == 2
    assert what in capsys.readouterr().err


def test_a_sphere_that_comes_upon_the_clamp_is_not_compared():
    organ = ball_of_cells()  # held at its foot
    assert pinch_reference.meets_clamp(organ, two_tools.place(organ, 2, two_tools.SPHERE)).tolist() == [True, False]
    assert not pinch_reference.meets_clamp(organ, two_tools.place(organ, 0, two_tools.SPHERE)).any()


def test_what_did_not_settle_is_reported_and_leaves_the_bound_open():
    force = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])
    good = pinch_reference.Compared("x", 20.0, 1.08 * force, force, 0.5, 0.7)
    found = pinch_reference.as_json([good, good._replace(axis="z", fraction=40.0)])
    assert found["bound"]["value"] == pytest.approx(8.0)
    lost = pinch_reference.as_json([good, good._replace(reference=None, reference_least=None)])
    assert lost["bound"]["value"] is None
    assert pinch_reference.lines(lost["rows"])[-1].split()[-3:] == ["-", "0.50", "-"]
    assert json.loads(json.dumps(lost, allow_nan=False)) == lost


@pytest.mark.extended
def test_finite_elements_are_compressed_on_two_meshes(monkeypatch):
    monkeypatch.setattr(pinch_reference, "FRACTIONS", (0.05,))
    organ = ball_of_cells()
    both = [pinch_reference.compressed_between(organ, 0, mesh) for mesh in pinch_reference.MESHES]
    (row,) = pinch_reference.rows_of(0, *both)
    force, coarse, fine = (np.array(row[name]) for name in ("force_n", "coarse_n", "fine_n"))
    np.testing.assert_allclose(force, fine - (coarse - fine) / 3.0, atol=1e-5)
    assert force[0, 0] < -0.01
    assert force[1, 0] == pytest.approx(-force[0, 0], rel=0.2)
    assert 0.0 < row["least_volume"] < 1.0
