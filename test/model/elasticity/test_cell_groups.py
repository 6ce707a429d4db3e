"""Cells in fans: each in one, three around an edge, and forces that are those of the cells."""

from dataclasses import replace

import numpy as np

from helpers.naive import naive_cells
from helpers.scenes import ball
from tissue_sim.model.data.blocks import BLOCK
from tissue_sim.model.elasticity.assembly import assemble
from tissue_sim.model.elasticity.cell_groups import CONSTANTS, OWN, OWN_ROWS, cell_forces, cell_groups_of, paths
from tissue_sim.model.elasticity.cells import cells_of, shapes_of, tissue_of
from tissue_sim.organ.cell_mesh import with_cells

ORGAN = with_cells(ball(2))
MODEL = assemble(ORGAN, "cells")
CELLS = cells_of(MODEL.tissue)[0].astype(np.int64)


def shared(one, other):
    return set(CELLS[one].tolist()) & set(CELLS[other].tolist())


def test_every_cell_is_in_one_fan_and_hardly_any_fan_lacks_one():
    fans = paths(MODEL.rest, CELLS)
    np.testing.assert_array_equal(np.sort(fans[fans >= 0]), np.arange(len(CELLS)))
    assert fans[:, 1].min() >= 0
    assert len(fans) < 1.05 * len(CELLS) / 3.0


def test_cells_of_a_fan_share_a_face_with_the_next_and_all_the_edge():
    full = [fan for fan in paths(MODEL.rest, CELLS) if fan.min() >= 0]
    for first, middle, last in full:
        assert len(shared(first, middle)) == len(shared(middle, last)) == 3
        assert len(shared(first, middle) & shared(middle, last)) == 2


def test_blocks_hold_every_cell_once_with_its_moduli_and_volume():
    fans = MODEL.tissue.groups
    held = fans.cells[fans.cells >= 0]
    np.testing.assert_array_equal(np.sort(held), np.arange(len(CELLS)))
    rows = fans.constants.reshape(-1, CONSTANTS, BLOCK).transpose(0, 2, 1).reshape(-1, CONSTANTS)
    own = rows[:, OWN:].reshape(-1, 3, OWN_ROWS)[fans.cells >= 0]
    volume = shapes_of(MODEL.rest, CELLS)[1]
    np.testing.assert_allclose(own[:, 0], 1.0 / (6.0 * volume[held]), rtol=1e-9)
    np.testing.assert_allclose(own[:, 1], ORGAN.cell_lambda[held] / 12.0, rtol=1e-12)
    np.testing.assert_allclose(own[:, 2], ORGAN.cell_mu[held] / 6.0, rtol=1e-12)
    np.testing.assert_allclose(6.0 * own[:, 3], cells_of(MODEL.tissue)[2][held], rtol=1e-12)
    assert not rows[:, OWN:].reshape(-1, 3, OWN_ROWS)[fans.cells < 0][:, 1:].any()


def test_a_cell_alone_and_one_that_lacks_a_neighbour_push_as_they_do_in_full_fans():
    draw = np.random.default_rng(0)
    for count in (1, 2, 3, 7, BLOCK + 1):
        some = draw.choice(len(CELLS), count, replace=False) if count > 3 else np.arange(count)
        tissue = tissue_of(MODEL.rest, CELLS[some].astype(np.int32), ORGAN.cell_mu[some], ORGAN.cell_lambda[some])
        x = MODEL.rest + 0.001 * draw.standard_normal(MODEL.rest.shape)
        wanted, found = naive_cells(x, MODEL._replace(tissue=tissue)), np.zeros_like(x)
        cell_forces(x, tissue, 1.0, found)
        assert np.abs(found - wanted).max() < 1e-12 * np.abs(wanted).max()
        untouched = np.setdiff1d(np.arange(len(x)), CELLS[some])
        assert not found[untouched].any()


def test_cells_on_the_same_side_of_a_face_are_no_neighbours():
    rest = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.2, 0.2, 2.0]])
    cells = np.array([[0, 1, 2, 3], [0, 1, 2, 4]])
    assert paths(rest, cells).max(axis=1).tolist() == [0, 1]
    tissue = tissue_of(rest, cells.astype(np.int32), np.array([2e3, 3e3]), np.array([4e3, 1e3]))
    x = rest + 0.1 * np.random.default_rng(1).standard_normal(rest.shape)
    found = np.zeros_like(x)
    cell_forces(x, tissue, 1.0, found)
    wanted = naive_cells(x, MODEL._replace(rest=rest, tissue=tissue))
    assert np.abs(found - wanted).max() < 1e-12 * np.abs(wanted).max()


def test_cells_hold_their_stiffness_by_themselves_not_by_their_place_in_a_fan():
    factor = np.exp(np.random.default_rng(2).normal(size=(2, len(CELLS))))
    uneven = replace(ORGAN, cell_mu=factor[0] * ORGAN.cell_mu, cell_lambda=factor[1] * ORGAN.cell_lambda)
    slope = shapes_of(MODEL.rest, CELLS)[0]
    fans = cell_groups_of(MODEL.rest, CELLS, slope, uneven.cell_mu, uneven.cell_lambda)
    even = MODEL.tissue.groups
    np.testing.assert_array_equal(fans.nodes, even.nodes)
    model = assemble(uneven, "cells")
    x = MODEL.rest + 0.001 * np.random.default_rng(3).standard_normal(MODEL.rest.shape)
    found, wanted = np.zeros_like(x), naive_cells(x, model)
    cell_forces(x, model.tissue, 1.0, found)
    assert np.abs(found - wanted).max() < 1e-12 * np.abs(wanted).max()
