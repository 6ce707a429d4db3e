"""Bodies given by a lattice: their surface, places inside cells, rigid motions."""

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from tissue_sim.bench.measured.lattice import EDGES, places, rigid_motion, shell

CORNERS = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])


def test_shell_is_closed_and_points_outward():
    index, triangles = shell((5, 3, 4))
    mesh = trimesh.Trimesh(index, triangles, process=False)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.volume == pytest.approx(4 * 2 * 3)
    assert len(index) == 5 * 3 * 4 - 3 * 1 * 2
    assert len(triangles) == 2 * len(index) - 4


def test_diagonals_take_turns():
    index, triangles = shell((9, 9, 9))
    sides = index[triangles] - index[np.roll(triangles, 1, axis=1)]
    diagonal = sides[np.abs(sides).sum(axis=2) == 2]
    for flat in range(3):
        across = np.delete(diagonal[diagonal[:, flat] == 0], flat, axis=1)
        assert np.sum(np.prod(across, axis=1) > 0) == np.sum(np.prod(across, axis=1) < 0)


def test_places_are_exact_for_what_cells_hold():
    random = np.random.default_rng(1)
    points = random.dirichlet(np.ones(4), 20)[:, 1:]
    slope, bend = random.normal(size=3), random.normal(size=(3, 3))

    def linear(x):
        return 2.0 + x @ slope

    def quadratic(x):
        return linear(x) + np.einsum("pi,ij,pj->p", x, bend, x)

    np.testing.assert_allclose(places(points, CORNERS, np.arange(4)[None]) @ linear(CORNERS), linear(points))
    nodes = np.concatenate([CORNERS, [(CORNERS[a] + CORNERS[b]) / 2 for a, b in EDGES]])
    np.testing.assert_allclose(places(points, nodes, np.arange(10)[None]) @ quadratic(nodes), quadratic(points))


def test_a_point_outside_takes_the_cell_that_it_leaves_least():
    nodes = np.concatenate([CORNERS, CORNERS + [5.0, 0.0, 0.0]])
    chosen = places(np.array([[1.0, 0.1, 0.1], [5.0, -0.1, 0.2]]), nodes, np.arange(8).reshape(2, 4))
    assert chosen[[0]].indices.max() < 4 <= chosen[[1]].indices.min()
    np.testing.assert_allclose(chosen @ nodes, [[1.0, 0.1, 0.1], [5.0, -0.1, 0.2]])


def test_rigid_motion_is_found_again():
    points = np.random.default_rng(2).normal(size=(3, 3))
    turn, shift = Rotation.from_rotvec([0.3, -0.2, 1.1]).as_matrix(), np.array([1.0, 2.0, 3.0])
    rotation, found = rigid_motion(points, points @ turn.T + shift)
    np.testing.assert_allclose(rotation, turn, atol=1e-12)
    np.testing.assert_allclose(found, shift, atol=1e-12)
