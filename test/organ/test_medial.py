"""The M-rep implies the boundary it was made from."""

import numpy as np
import pytest

from tissue_sim.errors import UserError
from tissue_sim.organ.medial import implied_boundary, nearest_atoms, neighbours, represent


def kidney_like():
    rng = np.random.default_rng(11)
    s = np.linspace(-0.04, 0.04, 48)
    atoms = np.stack([0.01 * np.cos(20 * s), 0.02 * s, s], axis=1)
    boundary = rng.normal(size=(994, 3)) * np.array([0.02, 0.02, 0.05])
    return boundary, atoms, np.arange(-1, 47)


def test_at_rest_the_implied_boundary_is_the_boundary():
    boundary, atoms, parent = kidney_like()
    rep = represent(boundary, atoms, parent)
    assert np.abs(implied_boundary(atoms, rep) - boundary).max() < 1e-9
    np.testing.assert_allclose(rep.length, np.linalg.norm(boundary - atoms[rep.atom], axis=1))
    assert rep.theta.min() >= 0.0
    assert rep.theta.max() <= np.pi


def test_a_rigid_motion_of_skeleton_and_orientation_moves_the_boundary_rigidly():
    boundary, atoms, parent = kidney_like()
    rep = represent(boundary, atoms, parent)
    turn, _ = np.linalg.qr(np.random.default_rng(2).normal(size=(3, 3)))
    turn *= np.sign(np.linalg.det(turn))
    shift = np.array([0.1, -0.2, 0.3])
    moved = implied_boundary(atoms @ turn.T + shift, rep, rep.orientation @ turn.T)
    np.testing.assert_allclose(moved, boundary @ turn.T + shift, atol=1e-12)


def test_spokes_along_the_skeleton_are_implied_too():
    atoms = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.01]])
    boundary = np.array([[0.0, 0.0, 0.03], [0.0, 0.0, -0.02], [0.0, 0.005, 0.01]])
    rep = represent(boundary, atoms, [-1, 0])
    np.testing.assert_allclose(implied_boundary(atoms, rep), boundary, atol=1e-12)


def test_neighbours_are_parents_and_the_roots_first_child():
    np.testing.assert_array_equal(neighbours([-1, 0, 1, 1]), [1, 0, 1, 1])
    with pytest.raises(UserError, match="two atoms or more"):
        neighbours([-1])


def test_the_four_nearest_atoms_come_nearest_first():
    boundary, atoms, _ = kidney_like()
    index, distance = nearest_atoms(boundary, atoms)
    assert index.shape == (994, 4)
    assert np.all(np.diff(distance, axis=1) >= 0)
    every = np.linalg.norm(boundary[:, None] - atoms[None], axis=2)
    np.testing.assert_allclose(distance, np.sort(every, axis=1)[:, :4])
    assert nearest_atoms(boundary, atoms[:2])[0].shape == (994, 2)
