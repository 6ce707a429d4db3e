"""Virtual nodes: which copies share them, and where a cut ends."""

from itertools import combinations

import numpy as np
import pytest

from helpers.bars import bar
from helpers.scenes import ball_of_cells
from tissue_sim.model.cutting.crossing import crossing_among
from tissue_sim.model.cutting.sheet import sheet_of
from tissue_sim.model.cutting.virtual_nodes import copies_of

DOWN = [0.0, 0.0, -1.0]
FLAT = [[-0.015, 0.001, 0.03], [0.015, 0.001, 0.03]], DOWN, 0.02
BENT = [[-0.02, 0.001, 0.03], [0.001, 0.001, 0.03], [0.001, 0.02, 0.03]], DOWN, 0.02


def made(organ, cut):
    crossing = crossing_among(organ.rest_positions, organ.cell_nodes, sheet_of(organ, *cut))[0]
    return crossing, copies_of(organ.cell_nodes, crossing, organ.fixed, organ.n_nodes)


def faces_of(cells):
    """The cells at each face, by its nodes, and the places of these in the cells."""
    found = {}
    for cell, nodes in enumerate(cells.tolist()):
        for places in combinations(range(4), 3):
            face = tuple(sorted(nodes[place] for place in places))
            found.setdefault(face, []).append(cell)
    return {face: owners for face, owners in found.items() if len(owners) == 2}


def nodes_at(copy, cell_nodes, face):
    return [int(copy[list(cell_nodes).index(node)]) for node in face]


@pytest.mark.parametrize("cut", [FLAT, BENT], ids=["flat", "bent"])
def test_copies_meet_at_faces_and_hang_on_what_is_not_divided(cut):
    organ = ball_of_cells(2, 60)
    crossing, copies = made(organ, cut)
    row = {int(cell): k for k, cell in enumerate(crossing.cells)}
    joined = hung = 0
    for face, (one, other) in faces_of(organ.cell_nodes).items():
        sides = {bool(crossing.positive[node]) for node in face}
        if one in row and other in row:
            for side, copy in ((False, copies.below), (True, copies.above)):
                if side in sides:  # the face has a part on that side
                    first, second = (nodes_at(copy[row[c]], organ.cell_nodes[c], face) for c in (one, other))
                    assert first == second
                    joined += 1
        elif (one in row or other in row) and len(sides) == 2:
            divided = one if one in row else other
            for copy in (copies.below, copies.above):
                assert nodes_at(copy[row[divided]], organ.cell_nodes[divided], face) == list(face)
            hung += 1
    assert joined > 50
    assert hung > 5


def test_no_node_is_shared_across_a_cut_that_goes_through():
    organ = bar()
    crossing, copies = made(organ, ([[0.054, -0.01, 0.021], [0.054, 0.03, 0.021]], DOWN, 0.05))
    assert not np.intersect1d(copies.below, copies.above).size
    assert len(copies.virtual_of) == 18  # two layers of nine nodes
    np.testing.assert_array_equal(np.sort(copies.virtual_of), np.unique(organ.cell_nodes[crossing.cells]))
