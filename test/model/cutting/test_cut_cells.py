"""Cells in which blades find their places: barycentric weights, neighbours, and both sides of a cut."""

import numpy as np

from helpers.slabs import INCISION, slab
from tissue_sim.model.cutting.cut_cells import cut_cells_of, sides_of
from tissue_sim.model.cutting.sheet import sheet_of
from tissue_sim.model.simulation import Simulation


def weights(cells, cell, place):
    return cells.base[cell] + cells.slope[cell] @ place


def test_weights_are_those_of_the_corners_and_of_the_middle():
    organ = slab()
    cells = cut_cells_of(organ)
    rest = organ.rest_positions
    for cell in (0, 17, len(cells.nodes) - 1):
        corners = rest[cells.nodes[cell]]
        assert np.allclose([weights(cells, cell, corner) for corner in corners], np.eye(4), atol=1e-12)
        assert np.allclose(weights(cells, cell, corners.mean(axis=0)), 0.25)


def test_neighbours_share_a_face_and_know_each_other():
    cells = cut_cells_of(slab())
    cell, corner = np.nonzero(cells.neighbour >= 0)
    for one, opposite in list(zip(cell, corner, strict=True))[::97]:
        other = cells.neighbour[one, opposite]
        face = set(np.delete(cells.nodes[one], opposite))
        assert face < set(cells.nodes[other])
        assert one in cells.neighbour[other]
    # Each face without a neighbour is a triangle of the surface.
    assert np.count_nonzero(cells.neighbour < 0) == len(slab().surface_triangles)


def test_each_node_has_a_cell_around_it():
    organ = slab()
    cells = cut_cells_of(organ)
    assert all(node in cells.nodes[cell] for node, cell in enumerate(cells.first))


def test_both_sides_of_a_cut():
    organ = slab()
    cut = Simulation(organ).cut(*INCISION).cut_organ
    sides = sides_of(cut)
    cells = cut_cells_of(cut.organ, sides)
    differ = (sides.below != sides.above).any(axis=1)
    divided = np.unique(cut.cell_of[cut.side != 0])
    assert set(np.flatnonzero(differ)) <= set(divided)
    assert differ.sum() > 0.5 * len(divided)
    whole = cut_cells_of(organ)
    assert np.array_equal(cells.base, whole.base)
    assert np.array_equal(cells.neighbour, whole.neighbour)
    # What the sheet has passed is cut, and what its front has only been moved to is not.
    sheet = sheet_of(organ, *INCISION)
    middle = organ.rest_positions[organ.cell_nodes].mean(axis=1)
    deepest = -(middle[sides.is_cut == 1] @ sheet.direction).min()
    assert sides.is_cut.any()
    assert not sides.is_cut[~np.isin(np.arange(len(middle)), divided)].any()
    assert deepest >= INCISION[0][0][2] - INCISION[2] - 1e-9


def test_the_front_of_a_cut_is_not_cut_by_a_deeper_one_beside_it():
    deep = [[0.011, -0.01, 0.031], [0.011, 0.04, 0.031]], INCISION[1], 0.025
    shallow = [[0.0265, -0.01, 0.031], [0.0265, 0.04, 0.031]], INCISION[1], 0.012
    alone = [sides_of(Simulation(slab()).cut(*one).cut_organ).is_cut for one in (deep, shallow)]
    both = sides_of(Simulation(slab()).cut(*deep).cut(*shallow).cut_organ).is_cut
    assert np.array_equal(both, alone[0] | alone[1])
