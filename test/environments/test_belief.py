"""The belief of how an organ lies: distances of a known shape, and where touches say that it is."""

from typing import Any, NamedTuple

import numpy as np
import pytest
import trimesh

from tissue_sim.environments.belief import Belief, Shape, shape_of

RADIUS, SHIFT, TURN = 0.008, 0.015, 0.35


class Egg(NamedTuple):
    """A surface with half axes of 20, 30 and 45 mm."""

    points: Any
    triangles: Any
    normals: Any


@pytest.fixture(scope="module")
def egg():
    sphere = trimesh.creation.icosphere(3)
    axes = np.array([0.020, 0.030, 0.045])
    normals = sphere.vertices / axes
    return Egg(sphere.vertices * axes, sphere.faces, normals / np.linalg.norm(normals, axis=1, keepdims=True))


def turned(vectors, angle):
    cosine, sine = np.cos(angle), np.sin(angle)
    return vectors @ np.array([[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]])


def touches(organ, shift, angle, depth):
    """Middles of a finger that touches all over, depth m deep, and the normals there."""
    points, normals = organ.points[::7], organ.normals[::7]
    return turned(points + (RADIUS - depth) * normals, angle) + shift, turned(normals, angle)


def test_distances_are_those_of_the_surface_and_grow_outwards(egg):
    shape, points, normals = Shape(egg.points, egg.triangles), egg.points[::5], egg.normals[::5]
    for shift in (-0.006, 0.0, 0.01):
        np.testing.assert_allclose(shape.distance(points + shift * normals), shift, atol=7e-4)
    outward = shape.outward(points + 0.006 * normals)
    assert np.median(np.einsum("nx,nx->n", outward, normals)) > 0.99


@pytest.mark.parametrize(("shift", "angle"), [([0.01, -0.012, 0.006], 0.2), ([-0.013, 0.004, -0.011], -0.3)])
def test_touches_say_where_the_organ_lies(egg, shift, angle):
    belief = Belief(Shape(egg.points, egg.triangles), 2, SHIFT, TURN)
    place = egg.points[np.argmax(egg.points[:, 1])]
    truth = turned(place, angle) + shift
    before, spread = belief.where(place)
    assert np.linalg.norm(before[0] - truth) > 0.008
    force, compliance = 0.1, 0.02
    tips, normals = touches(egg, shift, angle, force * compliance)
    for tip, normal in zip(tips, normals, strict=True):
        belief.take(np.tile(tip, (2, 1)), force * np.stack([normal, 0.0 * normal]), RADIUS, np.full(2, compliance))
    found, sure = belief.where(place)
    assert np.linalg.norm(found[0] - truth) < 0.0025
    assert sure[0] < 0.3 * spread[0]
    assert np.linalg.norm(found[1] - truth) < 0.004, "where nothing is felt there is no tissue, which tells as much"


def test_another_compliance_leads_astray_and_forgetting_begins_again(egg):
    belief = Belief(Shape(egg.points, egg.triangles), 2, SHIFT, TURN)
    first = belief.guesses.copy()
    tips, normals = touches(egg, np.zeros(3), 0.0, 0.004)
    errors = []
    for compliance in (0.04, 0.0):
        belief.forget(np.arange(2))
        for tip, normal in zip(tips[:20], normals[:20], strict=True):
            belief.take(np.tile(tip, (2, 1)), np.tile(0.1 * normal, (2, 1)), RADIUS, np.full(2, compliance))
        errors.append(np.linalg.norm(belief.where(np.zeros(3))[0][0]))
    assert errors[0] < errors[1]
    belief.forget(np.array([1]))
    np.testing.assert_array_equal(belief.guesses[1], first[1])
    assert np.any(belief.guesses[0] != first[0])


def test_a_shape_is_computed_once_and_for_each_surface_anew(egg):
    assert shape_of(egg.points.copy(), egg.triangles.copy()) is shape_of(egg.points, egg.triangles)
    larger = shape_of(1.1 * egg.points, egg.triangles)
    assert larger is not shape_of(egg.points, egg.triangles)
    same = Shape(egg.points, egg.triangles).distance(egg.points[:5])
    np.testing.assert_array_equal(shape_of(egg.points, egg.triangles).distance(egg.points[:5]), same)
