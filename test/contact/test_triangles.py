"""Nearest points of triangles, against trimesh and by sampling."""

import numpy as np
import pytest
import trimesh

from tissue_sim.contact.triangles import closest_points, nearest_among, nearest_weights
from tissue_sim.organ.winding import inside


@pytest.mark.parametrize("height", [1.0, 1e-2, 1e-4])
@pytest.mark.parametrize("size", [1.0, 1e-3])
def test_nearest_points_are_those_of_trimesh(size, height):
    random = np.random.default_rng(1)
    corners = size * random.standard_normal((3000, 3, 3))
    corners[:, 2] = corners[:, 0] + 0.3 * (corners[:, 1] - corners[:, 0]) + height * (corners[:, 2] - corners[:, 0])
    points = size * random.standard_normal((3000, 3))
    # trimesh takes small products of lengths for zero.
    wanted = trimesh.triangles.closest_point(1e3 / size * corners, 1e3 / size * points) * size / 1e3
    np.testing.assert_allclose(closest_points(corners, points), wanted, atol=1e-10 * size / height)
    weights, distance = nearest_weights(corners, points)
    assert weights.min() >= 0.0
    np.testing.assert_allclose(distance, np.linalg.norm(wanted - points, axis=1), rtol=1e-9, atol=1e-12 * size)


@pytest.mark.parametrize("height", [1e-6, 1e-8, 1e-12])
def test_nearest_point_of_a_sliver_is_as_near_as_its_longest_edge(height):
    random = np.random.default_rng(2)
    corners = np.tile([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.4, height, 0.0]], (500, 1, 1))
    points = random.standard_normal((500, 3))
    weights, distance = nearest_weights(corners, points)
    np.testing.assert_allclose(weights.sum(axis=1), 1.0, atol=1e-12)
    along = np.clip(points[:, :1], 0.0, 1.0) * (1.0, 0.0, 0.0)
    np.testing.assert_allclose(distance, np.linalg.norm(points - along, axis=1), atol=2.0 * height + 1e-12)


def test_nearest_weights_give_the_nearest_point():
    random = np.random.default_rng(0)
    corners, points = random.standard_normal((200, 3, 3)), random.standard_normal((200, 3))
    weights, distance = nearest_weights(corners, points)
    np.testing.assert_allclose(weights.sum(axis=1), 1.0, atol=1e-9)
    assert weights.min() > -1e-9
    np.testing.assert_allclose(
        np.linalg.norm(np.einsum("ij,ijk->ik", weights, corners) - points, axis=1), distance, atol=1e-9
    )
    # No other point of the triangle is nearer.
    others = np.einsum("kj,ijx->ikx", random.dirichlet([1, 1, 1], 300), corners)
    assert np.all(np.linalg.norm(others - points[:, None], axis=2).min(axis=1) >= distance - 1e-9)


def test_nearest_point_of_a_fine_triangle_is_no_farther_than_its_middle():
    """Half a millimetre in metres: products of its lengths are as small as 1e-13."""
    random = np.random.default_rng(0)
    corners = random.uniform(-3e-4, 3e-4, (500, 3, 3))
    points = random.uniform(-4e-4, 4e-4, (500, 3))
    _, distance = nearest_weights(corners, points)
    sampled = random.dirichlet([0.7, 0.7, 0.7], 400)
    near = np.linalg.norm(np.einsum("sk,tkc->tsc", sampled, corners) - points[:, None], axis=2).min(axis=1)
    assert np.all(distance <= near + 1e-12)
    assert np.all(distance >= near - 5e-5)


@pytest.mark.parametrize(
    "corners",
    [
        [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0]],
        [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 0.0, 0.0]],
        [[1.0, 1.0, 1.0]] * 3,
    ],
    ids=["line", "edge", "point"],
)
def test_triangle_without_area_gives_finite_weights(corners):
    weights, distance = nearest_weights(0.01 * np.array([corners]), np.array([[0.012, 0.003, 0.001]]))
    assert np.all(np.isfinite(weights))
    assert np.all(np.isfinite(distance))
    assert weights.sum() == pytest.approx(1.0)


def test_nearest_among_all_is_the_nearest_of_each_and_tells_inside_from_outside():
    random = np.random.default_rng(3)
    for solid in (trimesh.creation.icosphere(2, 0.05), trimesh.creation.box((0.05, 0.03, 0.02)).subdivide()):
        vertices, faces = np.asarray(solid.vertices), np.asarray(solid.faces)
        corners, points = vertices[faces], random.uniform(-0.06, 0.06, (300, 3))
        found, weights, distance = nearest_among(corners, points)
        each = np.tile(points, (len(corners), 1)), np.repeat(corners, len(points), axis=0)
        every = nearest_weights(each[1], each[0])[1].reshape(len(corners), len(points))
        np.testing.assert_allclose(distance, every.min(axis=0), rtol=1e-9, atol=1e-12)
        way = points - np.einsum("kc,kcx->kx", weights, corners[found])
        np.testing.assert_allclose(np.linalg.norm(way, axis=1), distance, rtol=1e-9, atol=1e-12)
        outside = np.einsum("kx,kx->k", way, solid.face_normals[found]) > 0.0
        np.testing.assert_array_equal(outside, ~inside(points, vertices, faces))
