"""A cut in a bag: it comes back as it was made; one with other cells than those that blades are in is refused."""

import numpy as np
import pytest

from helpers.slabs import INCISION, slab
from tissue_sim.contact.tools import Tool, ToolSet
from tissue_sim.model.cutting.cut_cells import sides_of
from tissue_sim.model.cutting.sheet import Coagulation, sheet_of
from tissue_sim.model.simulation import Simulation
from tissue_sim.ros.bags.recorded_cut import fields_of_cut, recorded_cuts

ACROSS = [[0.0, 0.0142, 0.031], [0.04, 0.0142, 0.031]], [0.0, 0.0, -1.0], 0.016


@pytest.fixture(scope="module")
def made():
    """The slab with two cuts that cross, for a knife."""
    simulation = Simulation(slab(), shapes=ToolSet([Tool("knife", shape="blade", length=0.02)]).shapes)
    return simulation.cut(*INCISION).cut(*ACROSS)


@pytest.fixture
def fields(made):
    return fields_of_cut(1, 10, made, made.organ.to_bytes())


def test_a_cut_comes_back(made, fields):
    (cut,) = recorded_cuts([fields])
    assert np.array_equal(cut.organ.cell_nodes, made.organ.cell_nodes)
    for ours, theirs in zip(cut.sides, sides_of(made.cut_organ), strict=True):
        assert np.array_equal(ours, theirs)
    for ours, theirs in zip(cut.surface, made.cut_organ.surface, strict=True):
        assert np.array_equal(ours, theirs)


def test_coagulated_walls_come_back_bit_for_bit():
    sheet = sheet_of(slab(), *INCISION)._replace(coagulation=Coagulation(4.0, 0.002))
    hot = Simulation(slab()).prepared_sheet(sheet)
    (cut,) = recorded_cuts([fields_of_cut(1, 10, hot, hot.organ.to_bytes())])
    assert hot.cuts[0].stiffer_cells
    assert np.array_equal(cut.organ.cell_mu, hot.organ.cell_mu)
    assert np.array_equal(cut.organ.cell_lambda, hot.organ.cell_lambda)


@pytest.mark.parametrize("kept", [slice(0, -1), slice(1, None), slice(0, 0), [*range(10), *range(10)]])
def test_sides_of_fewer_or_other_cells_are_refused(fields, kept):
    for name in ("below", "above", "is_cut"):
        fields[name] = fields[name][kept]
    with pytest.raises(ValueError, match="its cut has sides of other cells than its organ"):
        recorded_cuts([fields])


def test_sides_of_other_cells_beyond_the_first_are_refused(made, fields):
    fields["above"] = made.organ.cell_nodes[1 : len(fields["above"]) + 1].astype(np.int64)
    with pytest.raises(ValueError, match="its cut has sides of other cells"):
        recorded_cuts([fields])
