"""The finite-element mesh fills the organ's surface exactly, and is fine where it should be."""

import sys
from dataclasses import replace

import numpy as np
import pytest

from helpers.scenes import ball
from tissue_sim.calibration.fe_mesh import Grading, _meshed, clamp_edges, clamped_triangles, fill
from tissue_sim.calibration.fem import Body
from tissue_sim.errors import UserError
from tissue_sim.organ.normals import triangle_area


@pytest.mark.parametrize("grading", [Grading(), Grading(clamp=2, growth=0.8), Grading(clamp=0, whole=1)])
def test_mesh_fills_the_polyhedron(grading):
    organ = ball(2)
    mesh = fill(organ, grading=grading)
    np.testing.assert_array_equal(mesh.nodes[: organ.n_surface], organ.surface_positions)
    corners = mesh.nodes[mesh.elements[:, :4]]
    volume = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])).sum() / 6.0
    assert volume == pytest.approx(organ.volume, rel=1e-12)
    covered = np.bincount(mesh.triangle, triangle_area(mesh.nodes, mesh.facets))
    np.testing.assert_allclose(covered, triangle_area(organ.surface_positions, organ.surface_triangles), rtol=1e-9)
    np.testing.assert_array_equal(mesh.clamped, clamped_triangles(organ)[mesh.triangle])


def test_same_organ_gives_same_mesh_and_says_nothing(capfd):
    first = fill(ball(1))
    _meshed.cache_clear()
    second = fill(ball(1))
    for one, other in zip(first, second, strict=True):
        np.testing.assert_array_equal(one, other)
    assert capfd.readouterr() == ("", "")


def test_middles_lie_half_way_or_a_quarter_from_the_clamps_edge():
    organ = ball(2)
    mesh = fill(organ)
    corners = mesh.facets[:, :3]
    front = np.intersect1d(corners[mesh.clamped], corners[~mesh.clamped])
    ends = mesh.elements[:, [[0, 1], [1, 2], [0, 2], [0, 3], [1, 3], [2, 3]]]
    middle = mesh.nodes[mesh.elements[:, 4:]]
    a, b = mesh.nodes[ends[..., 0]], mesh.nodes[ends[..., 1]]
    fraction = np.linalg.norm(middle - a, axis=2) / np.linalg.norm(b - a, axis=2)
    at_a, at_b = np.isin(ends[..., 0], front), np.isin(ends[..., 1], front)
    wanted = np.where(at_a == at_b, 0.5, np.where(at_a, 0.25, 0.75))
    np.testing.assert_allclose(fraction, wanted, atol=1e-9)
    assert (at_a != at_b).any()
    np.testing.assert_allclose(np.linalg.norm(np.cross(middle - a, b - a), axis=2), 0.0, atol=1e-15)
    for facet, edges in ((mesh.facets[:, 3], (0, 1)), (mesh.facets[:, 4], (1, 2)), (mesh.facets[:, 5], (0, 2))):
        one, other = (mesh.nodes[mesh.facets[:, k]] for k in edges)
        along = np.linalg.norm(mesh.nodes[facet] - one, axis=1) + np.linalg.norm(mesh.nodes[facet] - other, axis=1)
        np.testing.assert_allclose(along, np.linalg.norm(other - one, axis=1), rtol=1e-9)


def sizes_at(mesh, points):
    """Longest edges of the elements that have a corner at one of the points."""
    corners = mesh.nodes[mesh.elements[:, :4]]
    there = (np.linalg.norm(corners[:, :, None] - points, axis=3) < 1e-9).any(axis=(1, 2))
    assert there.any()
    edges = [np.linalg.norm(corners[:, i] - corners[:, j], axis=1) for i in range(4) for j in range(i)]
    return np.max(edges, axis=0)[there]


def test_halvings_at_the_clamp_and_under_the_loads():
    organ = ball(1)
    edges = clamp_edges(organ.surface_triangles, clamped_triangles(organ))
    front = organ.surface_positions[np.unique(edges)]
    coarse, fine = (sizes_at(fill(organ, grading=Grading(clamp=k)), front).max() for k in (1, 3))
    assert fine <= 0.3 * coarse
    node = int(np.argmax(organ.surface_positions[:, 2]))
    top = organ.surface_positions[[node]]
    far, near = fill(organ, grading=Grading(clamp=0)), fill(organ, np.array([node]), Grading(clamp=0, near=2))
    assert sizes_at(near, top).max() <= 0.5 * sizes_at(far, top).max()


def test_finer_is_finer():
    organ, near = ball(1), np.array([0])
    counts = [len(fill(organ, near, grading).elements) for grading in (Grading(), Grading().finer())]
    assert counts[1] > 1.5 * counts[0]


def test_organ_that_nothing_holds_is_named():
    with pytest.raises(UserError, match=r"'ball'.*no triangle.*--fixed"):
        Body(ball(1, held=False))


def test_surface_that_cannot_be_filled_is_named():
    organ = ball(2)
    positions = organ.surface_positions.copy()
    top = int(np.argmax(positions[:, 2]))
    positions[top, 2] -= 0.08  # out through the other side
    with pytest.raises(UserError, match="remesh"):
        Body(replace(organ, surface_positions=positions))


@pytest.mark.parametrize("module", ["skfem", "netgen"])
def test_missing_library_is_named(monkeypatch, module):
    _meshed.cache_clear()
    monkeypatch.setitem(sys.modules, module, None)
    if module == "netgen":
        monkeypatch.setitem(sys.modules, "netgen.meshing", None)
    with pytest.raises(UserError, match=rf"needs {module}: pip install 'tissue_sim\[calibration\]'"):
        fill(ball(1))
