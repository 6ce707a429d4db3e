"""The M-rep implies the boundary it was made from."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from helpers.scenes import kidney
from tissue_sim.errors import UserError
from tissue_sim.model.elasticity.forces import return_forces
from tissue_sim.organ.medial import (
    implied_boundary,
    nearest_atoms,
    nearest_rotation,
    neighbours,
    recalculated_boundary,
    represent,
    smallest_rotation,
    transported_frames,
)


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


# recalculation ---------------------------------------------------------------------------------
def rotation(seed):
    turn, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    return turn * np.sign(np.linalg.det(turn))


def tree(seed):
    """A branching skeleton of 30 atoms in random places, and 200 boundary points around it."""
    rng = np.random.default_rng(seed)
    parent = np.array([-1, *(rng.integers(0, i) for i in range(1, 30))])
    atoms = np.zeros((30, 3))
    for i in range(1, 30):
        atoms[i] = atoms[parent[i]] + rng.normal(size=3) * 0.01
    return atoms[rng.integers(0, 30, 200)] + rng.normal(size=(200, 3)) * 0.01, atoms, parent


@pytest.mark.parametrize("make", [kidney_like, lambda: tree(3)], ids=["chain", "tree"])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_rigid_motion_of_the_skeleton_alone_moves_the_implied_boundary_rigidly(make, seed):
    boundary, atoms, parent = make()
    rep = represent(boundary, atoms, parent)
    np.testing.assert_allclose(recalculated_boundary(rep, atoms), boundary, atol=1e-9)
    turn, shift = rotation(seed), np.array([0.1, -0.2, 0.3])
    moved = recalculated_boundary(rep, atoms @ turn.T + shift)
    np.testing.assert_allclose(moved, boundary @ turn.T + shift, atol=1e-9)


def bent(rep_atoms, radius):
    """A skeleton along z bent to a circle of that radius in the plane y = 0."""
    angle = rep_atoms[:, 2] / radius
    return np.stack([radius * (1.0 - np.cos(angle)), np.zeros_like(angle), radius * np.sin(angle)], axis=1)


def straight(count=60):
    rng = np.random.default_rng(5)
    atoms = np.zeros((count, 3))
    atoms[:, 2] = np.linspace(-0.05, 0.05, count)
    angle, along = rng.uniform(0.0, 2.0 * np.pi, 500), rng.uniform(-0.049, 0.049, 500)
    return np.stack([0.01 * np.cos(angle), 0.01 * np.sin(angle), along], axis=1), atoms, np.arange(-1, count - 1)


def test_a_tube_that_is_bent_stays_a_tube_without_twist():
    """Closed form: bent in the plane y = 0, a point keeps its y, its distance to the middle and its place along it."""
    error = []
    for count in (60, 240):
        boundary, atoms, parent = straight(count)
        rep = represent(boundary, atoms, parent)
        moved = recalculated_boundary(rep, bent(atoms, 0.06))
        np.testing.assert_allclose(moved[:, 1], boundary[:, 1], atol=1e-12)
        np.testing.assert_allclose(np.linalg.norm(moved - bent(atoms, 0.06)[rep.atom], axis=1), rep.length, rtol=1e-9)
        angle, reach = boundary[:, 2] / 0.06, 0.06 - boundary[:, 0]
        exact = np.stack([0.06 - reach * np.cos(angle), boundary[:, 1], reach * np.sin(angle)], axis=1)
        error.append(np.abs(moved - exact).max())
    # The bones are straight, the circle is not: off by a bone's angle at most, and less with more bones.
    assert error[0] < 0.01 * (0.1 / 59) / 0.06
    assert error[1] < 0.3 * error[0]


def test_a_tube_along_a_helix_turns_from_bone_to_bone_about_no_bone():
    _, atoms, parent = straight()
    turn = 40.0 * atoms[:, 2]
    helix = np.stack([0.02 * np.cos(turn), 0.02 * np.sin(turn), 0.5 * atoms[:, 2]], axis=1)
    frames = transported_frames(atoms, helix, parent)
    np.testing.assert_allclose(frames @ frames.transpose(0, 2, 1), np.broadcast_to(np.eye(3), frames.shape), atol=1e-12)
    bones = np.diff(helix, axis=0)
    bones /= np.linalg.norm(bones, axis=1, keepdims=True)
    for i in range(2, 60):
        change = Rotation.from_matrix(frames[i] @ frames[i - 1].T).as_rotvec()
        assert np.linalg.norm(change) > 0.01
        assert abs(change @ bones[i - 1]) < 1e-9
        assert abs(change @ bones[i - 2]) < 1e-9


def test_a_slender_skeleton_bent_aside_is_not_turned_about_itself():
    _, atoms, parent = straight()
    slightly = atoms + np.stack([4.0 * atoms[:, 2] ** 2, np.zeros(60), np.zeros(60)], axis=1)
    aside = slightly + np.stack([np.zeros(60), 8.0 * atoms[:, 2] ** 2, np.zeros(60)], axis=1)
    frames = transported_frames(slightly, aside, parent)
    twist = Rotation.from_matrix(frames).as_rotvec()[:, 2]
    assert np.abs(twist).max() < np.deg2rad(45.0)


def test_nothing_is_infinite_where_atoms_coincide():
    boundary, atoms, parent = kidney_like()
    rep = represent(boundary, atoms, parent)
    coinciding = atoms.copy()
    coinciding[10] = coinciding[9]
    assert np.all(np.isfinite(recalculated_boundary(rep, coinciding)))
    assert np.all(np.isfinite(recalculated_boundary(rep, np.zeros_like(atoms))))
    assert np.all(np.isfinite(recalculated_boundary(rep, atoms * [1.0, 1.0, -1.0])))


def test_a_single_rotation_is_found_and_half_a_turn_has_an_axis():
    one = np.array([0.6, 0.0, 0.8])
    for other in (np.array([0.0, 1.0, 0.0]), one, -one):
        turn = smallest_rotation(one, other)
        np.testing.assert_allclose(turn @ one, other, atol=1e-12)
        np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(turn) == pytest.approx(1.0)
    points = np.random.default_rng(1).normal(size=(9, 3))
    np.testing.assert_allclose(nearest_rotation(points, points @ rotation(4).T), rotation(4), atol=1e-9)
    np.testing.assert_allclose(np.linalg.det(nearest_rotation(points, -points)), 1.0)


def test_the_implied_boundary_is_a_target_for_return_springs():
    """The skeleton is turned; return springs towards the boundary that it implies bring the surface after it."""
    organ = kidney()
    rep = represent(organ.surface_positions, organ.atom_positions, organ.atom_parent)
    turn = rotation(7)
    target = recalculated_boundary(rep, organ.atom_positions @ turn.T)
    nodes = np.arange(organ.n_surface, dtype=np.int32)
    position, force = organ.surface_positions.copy(), np.zeros((organ.n_surface, 3))
    return_forces(position, target, nodes, organ.return_stiffness, force)
    expected = organ.return_stiffness[: organ.n_surface, None] * (organ.surface_positions @ turn.T - position)
    np.testing.assert_allclose(force, expected, atol=1e-9)
