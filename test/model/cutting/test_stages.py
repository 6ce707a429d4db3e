"""Stages of a blade's cut: what one has divided stays divided in the next, whose sheet is another one."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from helpers.bars import bar
from tissue_sim.model.cutting.blade_path import BladePath
from tissue_sim.model.cutting.cut import cut_again, without_cuts

HEIGHT, MIDDLE = 0.03, 0.0215  # m, of the slab, and where it is cut along y, off the nodes
STRAIGHT_ON = 0.012  # m along y, from where on the blade turns aside
BENDS = (0.0, 80.0, -80.0)  # 1/m, curvature of its way


@cache
def block():
    organ = bar(8, 0.005, 6)
    return replace(organ, fixed=np.flatnonzero(organ.surface_positions[:, 2] == 0.0).astype(np.int32))


@cache
def stages(bend):
    """The slab after each stage of a scalpel's cut, which is drawn along y 12 mm deep and turns aside."""
    path, found = BladePath(block(), 1), [without_cuts(block())]
    for number, y in enumerate(np.linspace(0.004, 0.026, 45)):
        turned = max(0.0, y - STRAIGHT_ON)
        x = MIDDLE + 0.5 * bend * turned**2
        edge = np.stack([np.full(5, x), np.full(5, y), HEIGHT - np.linspace(0.0, 0.012, 5)], axis=1)
        forward = np.array([bend * turned, 1.0, 0.0])
        path.note(edge, forward / np.linalg.norm(forward), np.array([0.0, 0.0, -1.0]))
        if number % 4 == 3 and path.has_grown:
            found.append(cut_again(found[-1], path.sheet()))
            path.note_opened()
    return found


def copies(cut):
    """Number of each copy, by its cell and its side."""
    return {(int(cut.cell_of[k]), int(cut.side[k])): k for k in np.flatnonzero(cut.side)}


@pytest.mark.parametrize("bend", BENDS)
def test_copies_keep_their_nodes_when_the_blade_cuts_on(bend):
    """A copy whose cell was whole again, or whose node had changed sides, had a corner on the other lip at once."""
    assert len(stages(bend)) > 8
    for before, after in zip(stages(bend)[1:-1], stages(bend)[2:], strict=True):
        origin, there = after.origin(before), copies(after)
        for key, copy in copies(before).items():
            np.testing.assert_array_equal(origin[after.organ.cell_nodes[there[key]]], before.organ.cell_nodes[copy])


@pytest.mark.parametrize("bend", BENDS)
def test_cells_at_the_front_stay_torn_as_far_at_least(bend):
    for before, after in zip(stages(bend)[1:-1], stages(bend)[2:], strict=True):
        torn = [np.bincount(cut.cell_of, np.where(cut.side == 0, 0.0, cut.fraction)) for cut in (before, after)]
        assert np.all(torn[1] >= torn[0] - 1e-12)
        assert torn[1].sum() > torn[0].sum()
