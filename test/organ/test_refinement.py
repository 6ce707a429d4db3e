"""Which edges an organ's surface should have: where it is thin, near its clamp, and at named places."""

import numpy as np
import pytest

from helpers.shapes import solid
from tissue_sim.organ.refinement import (
    BESIDE,
    HINGE,
    NEAREST,
    SHORTEST,
    THROUGH,
    TOUCHED,
    Along,
    Ball,
    Painted,
    Refinement,
    clamp_rim,
    points_with,
    wanted_edges,
)
from tissue_sim.organ.surfaces.balloon import fibonacci_sphere
from tissue_sim.organ.surfaces.grading import split_in_place
from tissue_sim.organ.surfaces.sizing import GROWTH, local_edges
from tissue_sim.organ.tool_resolution import KIDNEY, relative_size

POSITIONS, TRIANGLES = fibonacci_sphere(1500)
POSITIONS *= [0.05, 0.05, 0.01]  # m: a flat organ
EDGE = local_edges(POSITIONS, TRIANGLES).mean()
HELD = np.flatnonzero(POSITIONS[:, 0] < -0.03)


def wanted(refinement, points):
    return wanted_edges(refinement, POSITIONS, TRIANGLES, HELD)(np.atleast_2d(points))


def test_nothing_is_wanted_where_nothing_is_asked_for():
    assert not Refinement()
    assert np.isinf(wanted(Refinement(), POSITIONS)).all()


def test_edges_go_by_thickness_down_to_a_bound():
    found = wanted(Refinement(thin=True), POSITIONS)
    middle = np.hypot(*POSITIONS[:, :2].T) < 0.01
    np.testing.assert_allclose(found[middle], THROUGH * 0.02, rtol=0.05)
    thinner = POSITIONS * [1.0, 1.0, 0.2]
    edge = local_edges(thinner, TRIANGLES).mean()
    found = wanted_edges(Refinement(thin=True), thinner, TRIANGLES, HELD)(thinner)
    assert found.min() == pytest.approx(SHORTEST * edge, rel=0.01)


def test_edges_go_by_the_distance_from_the_clamp():
    rim = clamp_rim(POSITIONS, TRIANGLES, HELD)
    np.testing.assert_allclose(rim[:, 0], -0.03, atol=EDGE)
    size = relative_size(4 / 3 * np.pi * 0.05 * 0.05 * 0.01)
    near, far = wanted(Refinement(clamp=True), [[-0.03, 0.0, 0.008], [0.03, 0.0, 0.008]])
    assert near < BESIDE * NEAREST * size, "thin at the clamp"
    assert far == pytest.approx(BESIDE * 0.06, rel=0.05)
    held, free = wanted(Refinement(clamp=True), [[-0.05, 0.0, 0.0], [-0.01, 0.0, 0.0098]])
    assert held > 1.5 * free, "what is held does not move"


def test_edges_at_the_clamp_of_a_slender_body_go_by_its_thickness():
    rod = POSITIONS * [1.0, 0.16, 0.8]
    found = wanted_edges(Refinement(clamp=True), rod, TRIANGLES, HELD)(np.array([[-0.03, 0.0, 0.0064]]))
    assert found == pytest.approx(HINGE * 2 * 0.008 * 0.8, rel=0.1)


def test_edges_at_the_clamp_of_a_thick_body_go_by_its_size():
    body = POSITIONS * [1.0, 1.0, 5.0]
    found = wanted_edges(Refinement(clamp=True), body, TRIANGLES, HELD)(np.array([[-0.028, 0.0, 0.04]]))
    assert relative_size(4 / 3 * np.pi * 0.05**3) == 1.0
    assert found == pytest.approx(BESIDE * NEAREST, rel=0.02)


def test_edges_go_by_the_distance_from_a_ball():
    ball = Ball(np.array([0.05, 0.0, 0.0]), 0.01, 0.002)
    inside, beyond = wanted(Refinement(places=(ball,)), [[0.045, 0.0, 0.0], [0.02, 0.0, 0.0]])
    assert inside == pytest.approx(0.002)
    assert beyond == pytest.approx(0.002 + GROWTH * 0.02)
    usual = wanted(Refinement(places=(Ball(ball.centre, 0.01),)), ball.centre)
    assert usual == pytest.approx(TOUCHED * EDGE)


def test_edges_go_by_the_distance_from_a_line():
    corners = np.array([[0.0, -0.02, 0.01], [0.0, 0.0, 0.01], [0.02, 0.0, 0.01]])
    line = Refinement(places=(Along(corners, 0.004, 0.002),))
    on, beside, past = wanted(line, [[0.0, -0.01, 0.01], [0.01, 0.009, 0.01], [0.027, 0.0, 0.01]])
    assert on == pytest.approx(0.002)
    assert beside == pytest.approx(0.002 + GROWTH * 0.005)
    assert past == pytest.approx(0.002 + GROWTH * 0.003)


def test_the_number_of_points_of_a_refined_surface_is_foretold():
    line = Refinement(places=(Along(np.array([[-0.02, 0.0, 0.01], [0.02, 0.0, 0.01]]), 0.01, 0.5 * EDGE),))
    count = points_with(line, POSITIONS, TRIANGLES, HELD)
    made = split_in_place(POSITIONS, TRIANGLES, wanted_edges(line, POSITIONS, TRIANGLES, HELD), 20_000)[0]
    assert len(POSITIONS) < count
    assert count - len(POSITIONS) == pytest.approx(len(made) - len(POSITIONS), rel=0.4)


def test_edges_go_by_the_distance_from_a_mask_also_outside_its_image():
    mask = solid(lambda x, y, z: np.maximum(np.maximum(abs(x), abs(y)), abs(z)) - 5.0, size=(31, 31, 31))
    painted = Refinement(places=(Painted(mask, 0.001),))
    inside, near, outside = wanted(painted, [[0.0, 0.0, 0.0], [0.009, 0.0, 0.0], [0.025, 0.0, 0.0]])
    assert inside == pytest.approx(0.001)
    assert near == pytest.approx(0.001 + GROWTH * 0.004, abs=4e-4)
    assert outside == pytest.approx(0.001 + GROWTH * 0.020, abs=4e-4)


def test_lengths_shrink_with_organs_smaller_than_a_kidney():
    assert relative_size(2 * KIDNEY) == 1.0
    assert relative_size(KIDNEY / 8) == pytest.approx(0.5)
