"""Signed distances of the tool shapes against closed forms."""

import numpy as np
import pytest

from helpers.turns import random_turns
from tissue_sim.model.contact.shapes import rotation_matrix, signed_distance
from tissue_sim.model.data.shapes import CAPSULE, CONVEX, GRID, SPHERE, Grid, make_shapes

BOX = np.array([0.02, 0.03, 0.01])  # m, half the extents


def box_planes():
    normals = np.vstack([np.eye(3), -np.eye(3)])
    return np.column_stack([normals, np.tile(BOX, 2)])


def box_distance(points):
    beyond = np.abs(points) - BOX
    return np.linalg.norm(np.maximum(beyond, 0.0), axis=-1) + np.minimum(beyond.max(axis=-1), 0.0)


def box_grid(spacing=0.0025):
    axes = [np.arange(-half - 0.01, half + 0.01 + spacing, spacing) for half in BOX]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    return Grid(box_distance(points), points[0, 0, 0], spacing)


# A second convex shape before the box, so that its planes don't begin at 0; the same for the grids.
NO_PLANES = np.zeros((0, 4))
SHAPES = make_shapes(
    [SPHERE, CAPSULE, CONVEX, CONVEX, GRID, GRID],
    [[0.012, 0.0], [0.004, 0.05], [0.0, 0.0], [0.0, 0.0], [0.0, 0.0], [0.0, 0.0]],
    [NO_PLANES, NO_PLANES, np.array([[0.0, 0.0, 1.0, 0.5]]), box_planes(), NO_PLANES, NO_PLANES],
    [None, None, None, None, Grid(np.ones((2, 3, 4)), np.zeros(3), 0.01), box_grid()],
)
POINTS = np.random.default_rng(0).uniform(-0.06, 0.06, (300, 3))


def at(tool, points=POINTS):
    """Distances (p,) and normals (p, 3)."""
    values = np.array([signed_distance(SHAPES, tool, *point) for point in points])
    return values[:, 0], values[:, 1:]


def test_sphere():
    distance, normal = at(0)
    np.testing.assert_allclose(distance, np.linalg.norm(POINTS, axis=1) - 0.012, atol=1e-15)
    np.testing.assert_allclose(normal, POINTS / np.linalg.norm(POINTS, axis=1)[:, None], atol=1e-14)


def test_capsule_lies_along_minus_z():
    nearest = np.zeros_like(POINTS)
    nearest[:, 2] = np.clip(POINTS[:, 2], -0.05, 0.0)
    arm = POINTS - nearest
    distance, normal = at(1)
    np.testing.assert_allclose(distance, np.linalg.norm(arm, axis=1) - 0.004, atol=1e-15)
    np.testing.assert_allclose(normal, arm / np.linalg.norm(arm, axis=1)[:, None], atol=1e-14)
    assert signed_distance(SHAPES, 1, 0.0, 0.0, -0.054)[0] == pytest.approx(0.0, abs=1e-15)
    assert signed_distance(SHAPES, 1, 0.0, 0.0, 0.004)[0] == pytest.approx(0.0, abs=1e-15)


def test_convex_is_exact_inside_and_a_lower_bound_outside():
    points = 0.5 * POINTS
    beyond = np.abs(points) - BOX
    true = np.linalg.norm(np.maximum(beyond, 0.0), axis=1) + np.minimum(beyond.max(axis=1), 0.0)
    distance, normal = at(3, points)
    inside = np.all(beyond < 0.0, axis=1)
    assert 30 < inside.sum() < 200
    np.testing.assert_allclose(distance[inside], true[inside], atol=1e-12)
    assert np.all(distance[~inside] > 0.0)
    assert np.all(distance[~inside] <= true[~inside] + 1e-12)
    facing = np.count_nonzero(beyond > 0.0, axis=1) == 1
    np.testing.assert_allclose(distance[facing], true[facing], atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1.0, atol=1e-15)


@pytest.mark.parametrize("tool", [0, 1, 3])
def test_normal_is_the_gradient_of_the_distance(tool):
    gradient = np.zeros_like(POINTS)
    for axis, step in enumerate(1e-7 * np.eye(3)):
        gradient[:, axis] = (at(tool, POINTS + step)[0] - at(tool, POINTS - step)[0]) / 2e-7
    wrong = np.abs(gradient - at(tool)[1]).max(axis=1) > 1e-4
    # A box's distance has creases; no more than a point or two lie that close to one.
    assert wrong.sum() <= (2 if tool == 3 else 0)


def test_centre_of_a_round_tool_has_a_normal_all_the_same():
    for tool, point in ((0, (0.0, 0.0, 0.0)), (1, (0.0, 0.0, -0.02))):
        distance, *normal = signed_distance(SHAPES, tool, *point)
        assert distance == -SHAPES.size[tool, 0]
        assert np.linalg.norm(normal) == 1.0


def test_rotation_matrix_equals_scipys():
    for turn in random_turns(20, np.random.default_rng(0)):
        matrix = np.zeros(9)
        rotation_matrix(turn.as_quat(), matrix)
        np.testing.assert_allclose(matrix.reshape(3, 3), turn.as_matrix(), atol=1e-14)


def test_grid_is_the_distance_between_its_points_and_a_lower_bound_beyond_them():
    true = box_distance(POINTS)
    distance, normal = at(5)
    within = np.all(np.abs(POINTS) < BOX + 0.01, axis=1)
    assert 20 < within.sum() < 200
    np.testing.assert_allclose(distance[within], true[within], atol=0.0008)  # at the box's edges; spacing 2.5 mm
    faces = within & (np.sort(np.abs(POINTS) - BOX, axis=1)[:, 1] < -0.004)
    np.testing.assert_allclose(distance[faces], true[faces], atol=1e-12)
    np.testing.assert_allclose(np.abs(normal[faces]).max(axis=1), 1.0, atol=1e-12)
    assert np.all(distance[~within] <= true[~within] + 0.0008)
    assert np.all(distance[~within] > 0.0)


def test_grid_far_away_is_far():
    assert signed_distance(SHAPES, 5, 1.0, 0.0, 0.0)[0] > 0.9


def test_bodies_belong_to_a_tool_each_unless_said():
    np.testing.assert_array_equal(SHAPES.tool, np.arange(6))
    np.testing.assert_array_equal(make_shapes([SPHERE, SPHERE], np.ones((2, 2)), tool=[0, 0]).tool, [0, 0])
