"""Sweeps over boxes against naive ones."""

import numpy as np
import trimesh

from helpers.scenes import kidney
from helpers.turns import random_turns
from tissue_sim.contact.broad_phase import (
    NearTriangles,
    PlacedBody,
    body_box,
    boxes_meet,
    holds_node,
    nearest_node,
    surface_box,
    triangles_in_box,
)
from tissue_sim.contact.contact_points import add_normals
from tissue_sim.contact.tools import Tool, ToolSet

ORGAN = kidney()
POSITION = ORGAN.rest_positions
N = ORGAN.n_surface


def test_box_is_that_of_the_surface_and_not_of_other_nodes():
    low, high = np.zeros(3), np.zeros(3)
    position = POSITION.copy()
    position[N:] += 10.0
    surface_box(position, N, low, high)
    np.testing.assert_array_equal(low, POSITION[:N].min(axis=0))
    np.testing.assert_array_equal(high, POSITION[:N].max(axis=0))


def test_triangles_in_a_box_are_those_whose_boxes_meet_it():
    found, number = (
        np.zeros((len(ORGAN.surface_triangles), 3), dtype=np.int64),
        np.zeros(len(ORGAN.surface_triangles), int),
    )
    rest = POSITION + np.random.default_rng(3).normal(0.0, 0.001, POSITION.shape)
    corners = POSITION[ORGAN.surface_triangles]
    for centre in np.random.default_rng(0).uniform(*np.array([POSITION.min(axis=0), POSITION.max(axis=0)]), (40, 3)):
        low, high = centre - [0.005, 0.01, 0.002], centre + [0.005, 0.01, 0.002]
        count, moved = triangles_in_box(
            POSITION, rest, ORGAN.surface_triangles, low, high, NearTriangles(found, number)
        )
        meets = np.all((corners.min(axis=1) <= high) & (corners.max(axis=1) >= low), axis=1)
        np.testing.assert_array_equal(number[:count], np.flatnonzero(meets))
        np.testing.assert_array_equal(found[:count], ORGAN.surface_triangles[meets])
        nodes = found[:count].ravel()
        assert moved == np.abs(POSITION - rest)[nodes].max(initial=0.0)


def test_boxes_meet_unless_they_lie_apart_along_an_axis():
    low, high = np.zeros(3), np.ones(3)
    for axis in range(3):
        for shift in (-1.001, -0.999, 0.999, 1.001):
            way = shift * np.eye(3)[axis]
            assert boxes_meet(low, high, low + way, high + way) == (abs(shift) < 1.0)


def test_nearest_node_is_the_nearest_surface_node():
    for point in np.random.default_rng(1).uniform(-0.1, 0.1, (40, 3)):
        node, squared = nearest_node(POSITION, N, *point)
        distance = np.linalg.norm(POSITION[:N] - point, axis=1)
        assert node == distance.argmin()
        np.testing.assert_allclose(squared, distance.min() ** 2, rtol=1e-12)


def test_normals_are_the_area_weighted_ones():
    normal = np.zeros((N, 3))
    add_normals(POSITION, ORGAN.surface_triangles, normal)
    mesh = trimesh.Trimesh(ORGAN.surface_positions, ORGAN.surface_triangles, process=False)
    expected = np.zeros((N, 3))
    for corner in range(3):
        np.add.at(expected, mesh.faces[:, corner], 2.0 * mesh.area_faces[:, None] * mesh.face_normals)
    np.testing.assert_allclose(normal, expected, atol=1e-15)


def test_tool_holds_a_node_when_one_lies_inside_it():
    tools = ToolSet([Tool("probe", "capsule", radius=0.004, length=0.03)])
    answers = []
    for turn, point in zip(
        random_turns(60, np.random.default_rng(0)), np.random.default_rng(2).uniform(-0.06, 0.06, (60, 3)), strict=True
    ):
        origin = POSITION[:N].mean(axis=0) + point
        low, high = np.zeros(3), np.zeros(3)
        body_box(tools.corners[0], tools.padding[0], turn.as_matrix().ravel(), origin, low, high)
        local = turn.inv().apply(POSITION[:N] - origin)
        axis = np.zeros_like(local)
        axis[:, 2] = np.clip(local[:, 2], -0.03, 0.0)
        inside = bool(np.any(np.linalg.norm(local - axis, axis=1) < 0.004))
        assert (
            holds_node(POSITION, N, PlacedBody(tools.shapes, 0, origin, turn.as_matrix().ravel(), low, high)) == inside
        )
        answers.append(inside)
    assert 5 < sum(answers) < 55
