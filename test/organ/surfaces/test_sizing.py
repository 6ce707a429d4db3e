"""Edges and thickness at the points of a surface."""

import numpy as np
import pytest
import trimesh

from tissue_sim.organ.surfaces.balloon import fibonacci_sphere
from tissue_sim.organ.surfaces.sizing import local_edges, relative_edges, thickness


def test_a_ball_is_as_thick_as_its_diameter_everywhere():
    positions, triangles = fibonacci_sphere(700)
    np.testing.assert_allclose(thickness(positions, triangles), 2.0, rtol=0.05)


def test_a_flat_ellipsoid_is_thin_in_its_middle_and_a_rim_is_thinner():
    positions, triangles = fibonacci_sphere(3000)
    positions *= [1.0, 1.0, 0.2]
    found = thickness(positions, triangles)
    middle = np.hypot(*positions[:, :2].T) < 0.2
    np.testing.assert_allclose(found[middle], 0.4, rtol=0.05)
    assert found.min() < 0.2
    assert np.quantile(found, 0.95) < 0.45


def test_a_dent_does_not_make_a_body_thin():
    """Points of the same side face each other across a fold, outside the body."""
    positions, triangles = fibonacci_sphere(3000)
    dented = positions * (1.0 - 0.4 * np.exp(-((1.0 - positions[:, 2]) / 0.05)))[:, None]
    assert thickness(dented, triangles).min() > 0.7


def test_edges_of_a_cube():
    mesh = trimesh.creation.box((1.0, 2.0, 3.0))
    found = local_edges(np.asarray(mesh.vertices), np.asarray(mesh.faces))
    assert len(found) == 8
    assert 1.0 < found.min() <= found.max() < np.hypot(2.0, 3.0)


def test_an_even_surface_has_one_size_and_a_graded_one_many():
    positions, triangles = fibonacci_sphere(700)
    np.testing.assert_array_equal(relative_edges(positions, triangles), 1.0)
    steep = positions * np.where(positions[:, 2:] > 0.0, 4.0, 1.0)
    size = relative_edges(steep, triangles)
    assert size.max() > 2.0 * size.min()
    lengths = local_edges(steep, triangles)
    assert np.corrcoef(size, lengths)[0, 1] > 0.9
    assert size.mean() == pytest.approx(1.0, abs=0.05)
