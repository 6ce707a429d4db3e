"""Flips, transport and relaxation keep a closed surface closed."""

import numpy as np

from tissue_sim.organ.normals import surface_normals
from tissue_sim.organ.surfaces.balloon import fibonacci_sphere
from tissue_sim.organ.surfaces.remesh import flip_edges
from tissue_sim.organ.surfaces.resample import thicken, thin_out
from tissue_sim.organ.surfaces.surface import corner_angles, measure
from tissue_sim.organ.surfaces.transport import relax, relax_sized, transport, transport_sized


def closed(positions, triangles):
    quality = measure(positions, triangles)
    return (quality.euler, quality.open_edges) == (2, 0) and quality.volume > 0


def test_transport_evens_a_stretched_sphere():
    positions, triangles = fibonacci_sphere(600)
    positions *= np.array([1.0, 1.0, 6.0])
    before = measure(positions, triangles)
    moved = 0
    for _ in range(40):
        moved += transport(positions, triangles, 2.0, 20)
        flip_edges(positions, triangles)
        assert closed(positions, triangles)
    after = measure(positions, triangles)
    assert moved > 50
    assert after.edge_variation < 0.5 * before.edge_variation
    assert len(positions) == 600
    assert len(np.unique(triangles)) == 600


def test_flips_reach_the_delaunay_condition():
    rng = np.random.default_rng(3)
    positions, triangles = fibonacci_sphere(400)
    positions += 0.03 * rng.standard_normal(positions.shape)
    positions /= np.linalg.norm(positions, axis=1, keepdims=True)
    least = corner_angles(positions, triangles).min()
    while flip_edges(positions, triangles):
        assert closed(positions, triangles)
    assert corner_angles(positions, triangles).min() >= least
    assert flip_edges(positions, triangles) == 0


def test_a_tetrahedron_is_left_alone():
    positions = np.array([[1.0, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])
    triangles = np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]], dtype=np.int32)
    assert flip_edges(positions, triangles) == 0
    assert transport(positions, triangles, 0.0, 10) == 0


def test_normals_of_a_sphere_are_radial():
    positions, triangles = fibonacci_sphere(500)
    normals = surface_normals(positions, triangles)
    assert np.einsum("ij,ij->i", normals, positions).min() > 0.995


def test_relaxation_evens_and_stays_on_the_sphere():
    rng = np.random.default_rng(5)
    positions, triangles = fibonacci_sphere(400)
    positions += 0.04 * rng.standard_normal(positions.shape)
    positions /= np.linalg.norm(positions, axis=1, keepdims=True)
    before = measure(positions, triangles).edge_variation
    for _ in range(20):
        relax(positions, triangles, 0.4)
        flip_edges(positions, triangles)
    assert measure(positions, triangles).edge_variation < 0.6 * before
    assert abs(np.linalg.norm(positions, axis=1) - 1.0).max() < 0.05


def test_sized_relaxation_and_transport_draw_points_to_where_edges_shall_be_short():
    positions, triangles = fibonacci_sphere(800)
    size = np.where(positions[:, 2] > 0.0, 0.6, 1.2)
    for _ in range(30):
        transport_sized(positions, triangles, 1.8, 20, size)
        flip_edges(positions, triangles)
        relax_sized(positions, triangles, 0.4, size)
        positions /= np.linalg.norm(positions, axis=1, keepdims=True)
        size[:] = np.where(positions[:, 2] > 0.0, 0.6, 1.2)
    assert closed(positions, triangles)
    upper = (positions[:, 2] > 0.0).mean()
    assert 0.65 < upper < 0.9  # densities 4 to 1 would give 0.8


def test_a_surface_is_brought_to_any_number_of_points():
    positions, triangles = fibonacci_sphere(900)
    fewer = thin_out(positions, triangles, 100)
    assert (len(fewer[0]), len(fewer[1])) == (800, 1596)
    more = thicken(*fewer, 150)
    assert (len(more[0]), len(more[1])) == (950, 1896)
    for surface in (fewer, more):
        assert closed(*surface)
        assert len(np.unique(surface[1])) == len(surface[0])
    assert len(positions) == 900  # what is given stays as it is
