"""Two tools that squeeze the organ: what is measured of it, and what the bounds say."""

import json

import numpy as np
import pytest

from helpers.scenes import ball
from tissue_sim.bench import pinch, two_tools
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
