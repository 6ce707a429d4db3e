"""Tetrahedra with faces on the sheet of a cut, and the same with these faces doubled."""

import numpy as np
import pytest
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from helpers.bars import bar
from tissue_sim.bench.cutting.split_mesh import opened, split
from tissue_sim.calibration.fe_mesh import Grading, Source, graded
from tissue_sim.model.cutting.sheet import sheet_of
from tissue_sim.organ.edges import CELL_FACES

TOP = 0.02
FLAT = [[0.018, 0.0087, TOP], [0.042, 0.0112, TOP]]
BENT = [[0.015, 0.0052, TOP], [0.0333, 0.0052, TOP], [0.0333, 0.0162, TOP]]
ACROSS = [[0.0312, -0.001, TOP], [0.0312, 0.021, TOP]]


def made(polyline, depth, size=0.004):
    organ = bar(6, 0.01, 2)
    sheet = sheet_of(organ, polyline, [0.0, 0.0, -1.0], depth)
    mesh = graded(organ, [Source(np.array([[0.03, 0.01, 0.015]]), size)], Grading(growth=0.5))
    still = np.arange(mesh.p.shape[1]) < organ.n_surface
    whole = split(mesh.p.T, mesh.t.T, sheet, still)
    return organ, sheet, whole, opened(whole, sheet)


def volumes(points, cells):
    corner = points[cells]
    return np.linalg.det(corner[:, 1:] - corner[:, :1]) / 6.0


def area(points, triangles):
    a, b, c = (points[triangles[:, k]] for k in range(3))
    return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()


@pytest.mark.parametrize(
    ("polyline", "depth", "wanted"),
    [(FLAT, 0.008, 0.0241299 * 0.008), (BENT, 0.009, 0.0293 * 0.009), (ACROSS, 0.011, 0.02 * 0.011)],
)
def test_walls_cover_the_sheet_and_nothing_else_changes(polyline, depth, wanted):
    organ, sheet, mesh, found = made(polyline, depth)
    volume = volumes(mesh.points, mesh.cells)
    assert volume.min() > 0.0
    assert volume.sum() == pytest.approx(organ.volume, rel=1e-9)
    np.testing.assert_array_equal(mesh.points[: organ.n_surface], organ.surface_positions)
    assert area(mesh.points, mesh.walls) == pytest.approx(wanted, rel=0.06)
    assert np.abs(sheet.place(mesh.points[np.unique(mesh.walls)]).across).max() < 5e-4
    assert volumes(found.points, found.cells) == pytest.approx(volume)
    np.testing.assert_array_equal(found.original[found.cells], mesh.cells)


def test_both_sides_have_walls_of_their_own_that_lie_on_each_other():
    _, sheet, mesh, found = made(FLAT, 0.008)
    np.testing.assert_array_equal(found.points[found.below], found.points[found.above])
    assert len(np.intersect1d(found.below, found.above)) == 0
    side = sheet.place(found.points[found.cells].mean(axis=1)).across
    assert side[np.isin(found.cells, found.below).any(axis=1)].max() < 0.0
    assert side[np.isin(found.cells, found.above).any(axis=1)].min() > 0.0
    faces = np.sort(found.cells[:, CELL_FACES].reshape(-1, 3), axis=1)
    faces, count = np.unique(faces, axis=0, return_counts=True)
    _, before = np.unique(np.sort(mesh.cells[:, CELL_FACES].reshape(-1, 3), axis=1), axis=0, return_counts=True)
    assert (count == 1).sum() == (before == 1).sum() + 2 * len(mesh.walls)
    front = np.setdiff1d(np.unique(mesh.walls), found.original[np.concatenate([found.below, found.above])])
    assert len(front) > 5, "the walls meet at the front"
    place = sheet.place(mesh.points[front])
    to_front = np.minimum(np.abs(place.below - 0.008), np.minimum(np.abs(place.along), np.abs(place.along - 0.02413)))
    assert to_front.max() < 1e-3


def test_a_cut_through_all_of_it_leaves_two_pieces():
    _, _, mesh, found = made(ACROSS, 0.03)

    def pieces(cells):
        pairs = cells[:, [0, 0, 0]].ravel(), cells[:, 1:].ravel()
        size = int(cells.max()) + 1
        joined = coo_array((np.ones(len(pairs[0])), pairs), shape=(size, size))
        return connected_components(joined, directed=False)[0]

    assert pieces(mesh.cells) == 1
    assert pieces(found.cells) == 2
