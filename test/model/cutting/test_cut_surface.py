"""The surface of a cut organ: closed, outward, of the same volume, and moved by its nodes."""

from itertools import product

import numpy as np
import pytest
import trimesh

from helpers.bars import bar
from helpers.scenes import ball_of_cells
from tissue_sim.model.cutting.holes import hole_triangles, open_edges
from tissue_sim.model.simulation import Simulation
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.surface_checks import signed_volume

DOWN = [0.0, 0.0, -1.0]
SHAPES = {
    "flat": [[-0.02, 0.001, 0.03], [0.02, 0.001, 0.03]],
    "short": [[-0.008, 0.003, 0.03], [0.01, -0.002, 0.03]],
    "L": [[-0.02, 0.001, 0.03], [0.001, 0.001, 0.03], [0.001, 0.02, 0.03]],
    "curved": [[0.02 * np.cos(a), 0.02 * np.sin(a) - 0.01, 0.03] for a in np.linspace(0.3, 2.8, 12)],
}


def assert_closed(surface):
    assert len(open_edges(surface.triangles.astype(np.int64))) == 0
    assert np.array_equal(np.unique(surface.triangles), np.arange(len(surface.nodes))), "points without a triangle"
    assert np.isfinite(surface.weights).all()
    np.testing.assert_allclose(surface.weights.sum(axis=1), 1.0, rtol=1e-12)


@pytest.mark.parametrize(("shape", "depth"), [*product(SHAPES, [0.012, 0.02, 0.07])])
def test_it_is_closed_and_keeps_the_volume(shape, depth):
    organ = ball_of_cells(2, 60)
    after = Simulation(organ).cut(SHAPES[shape], DOWN, depth)
    surface = after.cut_organ.surface
    assert_closed(surface)
    points = surface.at(after.model.rest)
    np.testing.assert_array_equal(points[: organ.n_surface], organ.surface_positions)
    assert signed_volume(points, surface.triangles) == pytest.approx(organ.volume, rel=1e-9)
    walls = surface.triangles[surface.wall == 1]
    assert len(walls)
    assert len(surface.triangles) == len(walls) + np.count_nonzero(surface.wall == 0)
    # Both walls lie on each other: no volume is between them.
    assert abs(signed_volume(points - points.mean(axis=0), walls)) < 1e-9 * organ.volume


def test_a_bar_cut_through_has_two_closed_surfaces_of_their_own_volumes():
    at = 0.054
    after = Simulation(bar()).cut([[at, -0.01, 0.021], [at, 0.03, 0.021]], DOWN, 0.05)
    surface = after.cut_organ.surface
    points = surface.at(after.model.rest)
    whole = trimesh.Trimesh(points, surface.triangles, process=False)
    assert whole.is_watertight
    assert whole.is_winding_consistent
    volumes = sorted(piece.volume for piece in whole.split(only_watertight=True))
    np.testing.assert_allclose(volumes, [at * 0.02**2, (0.12 - at) * 0.02**2], rtol=1e-9)
    area = trimesh.triangles.area(points[surface.triangles[surface.wall == 1]]).sum()
    assert area == pytest.approx(2.0 * 0.02**2, rel=1e-9)
    # It goes where the pieces go.
    moved, n = after.model.rest.copy(), bar().n_nodes
    right = moved[:, 0] > at
    right[n:] = ~right[n:]  # a virtual node belongs to the other side
    moved[right, 0] += 0.03
    apart = surface.at(moved)
    assert signed_volume(apart, surface.triangles) == pytest.approx(0.12 * 0.02**2, rel=1e-9)
    assert apart[:, 0].max() == pytest.approx(0.15, rel=1e-12)
    assert not np.any((apart[:, 0] > at + 1e-9) & (apart[:, 0] < at + 0.03 - 1e-9))


def test_the_surface_of_two_cuts_is_closed_too():
    organ = bar()
    first, second = ([[x, -0.01, 0.021], [x, 0.03, 0.021]] for x in (0.034, 0.086))
    after = Simulation(organ).cut(first, DOWN, 0.012).cut(second, DOWN, 0.03)
    surface = after.cut_organ.surface
    assert_closed(surface)
    assert set(surface.wall) == {0, 1, 2}
    assert signed_volume(surface.at(after.model.rest), surface.triangles) == pytest.approx(organ.volume, rel=1e-9)


@pytest.mark.parametrize("seed", range(8))
def test_random_cuts_of_the_kidney_are_closed(seed):
    """Its cells leave out flat ones, on the surface and inside."""
    organ = Organ.shipped()
    rng = np.random.default_rng(seed)
    node = rng.integers(organ.n_surface)
    point, normal = organ.surface_positions[node], organ.surface_normals[node]
    way = np.cross(normal, rng.normal(size=3))
    way *= rng.uniform(0.006, 0.02) / np.linalg.norm(way)
    bend = np.cross(normal, way) * rng.uniform(-0.5, 0.5)
    polyline = np.array([point - way + bend, point, point + way + bend]) + 0.003 * normal
    after = Simulation(organ).cut(polyline, -normal, rng.uniform(0.012, 0.03))
    surface = after.cut_organ.surface
    assert_closed(surface)
    volume = signed_volume(surface.at(after.model.rest), surface.triangles)
    assert volume == pytest.approx(organ.volume, rel=1e-9)
    assert after.cuts[0].critical_step_after >= 0.97 * after.cuts[0].critical_step_before


def test_holes_are_filled_against_their_rims():
    box = trimesh.creation.box()
    triangles = box.faces.astype(np.int64)
    left = triangles[3:]
    filled = hole_triangles(left, np.arange(8))
    assert len(open_edges(left))
    assert len(open_edges(np.concatenate([left, filled]))) == 0
    assert len(hole_triangles(triangles, np.arange(8))) == 0
