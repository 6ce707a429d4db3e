"""Mean value coordinates: what lies inside a surface goes with it."""

import numpy as np
import pytest
import trimesh

from helpers.scenes import kidney
from tissue_sim.organ.mean_value import mean_value_weights


def surface():
    return kidney().surface_positions, kidney().surface_triangles


def inner_points():
    return kidney().atom_positions[::3]


def test_they_sum_to_one_and_give_back_the_point():
    weights = mean_value_weights(inner_points(), *surface())
    np.testing.assert_allclose(weights.sum(axis=1), 1.0, atol=1e-12)
    np.testing.assert_allclose(weights @ surface()[0], inner_points(), atol=1e-9)


def test_points_go_along_exactly_where_the_surface_moves_affinely():
    weights = mean_value_weights(inner_points(), *surface())
    change, shift = np.array([[1.1, 0.2, 0.0], [0.0, 0.9, 0.1], [-0.1, 0.0, 1.2]]), np.array([0.01, 0.0, -0.02])
    np.testing.assert_allclose(weights @ (surface()[0] @ change + shift), inner_points() @ change + shift, atol=1e-9)


def test_a_node_counts_most_for_what_lies_under_it():
    positions, triangles = surface()
    normal = trimesh.Trimesh(positions, triangles, process=False).vertex_normals[100]
    weights = mean_value_weights(positions[100:101] - 1e-4 * normal, positions, triangles)
    assert weights[0].argmax() == 100
    assert weights[0, 100] > 0.9


def test_the_middle_of_a_box_stays_there():
    box = trimesh.creation.box((2.0, 2.0, 2.0))
    weights = mean_value_weights(np.zeros((1, 3)), np.asarray(box.vertices), np.asarray(box.faces))
    assert np.isfinite(weights).all()
    np.testing.assert_allclose(weights @ box.vertices, [[0.0, 0.0, 0.0]], atol=1e-12)
    assert weights.sum() == pytest.approx(1.0)
