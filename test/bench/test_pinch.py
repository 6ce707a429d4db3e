"""Two tools that squeeze the organ: what is measured of it, and what the bounds say."""

import json
from dataclasses import replace

import numpy as np
import pytest

from helpers.scenes import ball, ball_of_cells
from tissue_sim.bench import pinch, pinch_reference, two_tools
from tissue_sim.contact.tools import Tool
from tissue_sim.organ.cell_mesh import with_cells
from tissue_sim.organ.topology import assemble_like

SPHERES = [Tool("left", radius=0.005), Tool("right", radius=0.005)]


@pytest.fixture(scope="module")
def gentle():
    organ = with_cells(assemble_like(ball(2), interior_atoms=60))
    return two_tools.pinched(organ, "spheres", SPHERES, 0, 0.2)


def test_a_gentle_pinch_is_felt_and_leaves_nothing(gentle):
    assert gentle.width == pytest.approx(0.06, rel=0.1)
    assert gentle.force > 0.05
    assert 0.0 < gentle.least < 1.0
    assert gentle.held_turned == gentle.left_turned == gentle.faults == 0
    assert gentle.left < 1e-4
    assert len(gentle.seconds) == two_tools.CLOSING + two_tools.HOLDING + two_tools.OPENING
    assert gentle.seconds.min() >= 0.0


def test_bounds_take_the_worst_and_the_text_names_every_pinch(gentle):
    bad = gentle._replace(tools="jaws", axis=2, share=0.4, held_turned=3, left=2e-3, seconds=np.full(5, 1e-3))
    hard = bad._replace(share=0.6, held_turned=9)
    found = pinch.as_json([gentle, bad, hard], np.full(10, 5e-5))
    value = {bound["name"]: (bound["value"], bound["met"]) for bound in found["bounds"]}
    assert value["cells inside out, held at 20 and 40 %"] == (3, False)
    assert value["cells inside out long after"] == (0, True)
    assert value["what stays of the shape"] == (2.0, False)
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
    monkeypatch.setattr(pinch_reference, "SHARES", (0.1,))
    monkeypatch.setattr(pinch_reference, "SPEED", 0.1)
    monkeypatch.setattr(pinch_reference, "CLEAR", 0.001)


def table_of(organ, rows):
    return {"organ": organ.name, "fits": pinch_reference.fits(organ), "rows": rows}


def row_of(axis, force, share=10.0):
    return {"axis": axis, "share_percent": share, "force_n": force, "least_volume": 0.8}


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
