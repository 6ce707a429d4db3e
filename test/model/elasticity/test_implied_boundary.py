"""The compiled recalculation of the boundary against its NumPy twin, and return springs that follow it."""

import numpy as np
import pytest

from helpers.scenes import ball, filled, kidney
from tissue_sim.errors import UserError
from tissue_sim.model.elasticity.assembly import assemble
from tissue_sim.model.elasticity.frequency import largest_frequency
from tissue_sim.model.elasticity.implied_boundary import imply_boundary, spokes_of
from tissue_sim.model.simulation import Simulation
from tissue_sim.organ.medial import recalculated_boundary, represent, transported_frames


def rotation(rng):
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    return turn * np.sign(np.linalg.det(turn))


@pytest.mark.parametrize("organ", [ball(2), kidney()], ids=["straight", "kidney"])
@pytest.mark.parametrize("bending", [0.0, 1e-4, 1e-3, 1e-2])
def test_it_is_the_same_as_with_numpy(organ, bending):
    rng = np.random.default_rng(3)
    spokes = spokes_of(organ)
    rep = represent(organ.surface_positions, organ.atom_positions, organ.atom_parent)
    n = organ.n_surface
    for _ in range(5):
        moved = organ.atom_positions @ rotation(rng).T + rng.normal(size=3)
        moved += bending * np.cumsum(rng.normal(size=moved.shape), axis=0) / np.sqrt(len(moved))
        position = np.concatenate([organ.surface_positions, moved])
        target = np.zeros_like(position)
        imply_boundary(spokes, position, target)
        frames = transported_frames(organ.atom_positions, moved, organ.atom_parent)
        np.testing.assert_allclose(spokes.frame, frames, atol=1e-9)
        np.testing.assert_allclose(target[:n], recalculated_boundary(rep, moved), atol=1e-12)
        assert not target[n:].any()


def test_interior_atoms_are_implied_on_their_spokes():
    organ = filled(kidney(), 20)
    turn = rotation(np.random.default_rng(1))
    position = organ.rest_positions @ turn.T
    target = np.zeros_like(position)
    imply_boundary(spokes_of(organ), position, target)
    atoms = slice(organ.n_surface, organ.n_surface + organ.n_atoms)
    np.testing.assert_allclose(np.delete(target, atoms, axis=0), np.delete(position, atoms, axis=0), atol=1e-12)


def test_nothing_is_infinite_where_atoms_coincide():
    organ = kidney()
    spokes, n = spokes_of(organ), organ.n_surface
    target = np.zeros_like(organ.rest_positions)
    for atoms in (np.zeros((48, 3)), organ.atom_positions * [1.0, 1.0, -1.0], organ.atom_positions[[0] * 48]):
        imply_boundary(spokes, np.concatenate([organ.surface_positions, atoms]), target)
        assert np.all(np.isfinite(target))
        assert np.abs(np.linalg.norm(spokes.frame, axis=2) - 1.0).max() < 1e-9
    assert np.any(target[:n])


def pulled_aside(return_target, stiffness):
    """The kidney's skeleton pushed; how far the surface went along with it, and the simulation."""
    organ = kidney()
    simulation = Simulation(organ, return_target=return_target)
    simulation.model.return_stiffness[: organ.n_surface] *= stiffness
    simulation.frequency = largest_frequency(simulation.model)
    simulation.set_substeps()
    atoms = np.arange(organ.n_surface + 30, organ.n_surface + organ.n_atoms)
    for _ in range(400):
        simulation.apply_force(atoms, np.tile([0.004, 0.0, 0.0], (len(atoms), 1)))
        simulation.step()
    return (simulation.positions - simulation.model.rest)[:, 0], simulation


def test_return_springs_to_the_implied_boundary_let_the_surface_go_with_the_skeleton():
    """Towards rest they hold it back; towards where the skeleton implies it they take it along."""
    rest, _ = pulled_aside("rest", 10.0)
    implied, simulation = pulled_aside("implied", 10.0)
    n = kidney().n_surface
    assert implied[:n].max() > 1.2 * rest[:n].max()
    for _ in range(3000):
        simulation.step()
        assert np.all(np.isfinite(simulation.positions))
    assert simulation.asleep
    np.testing.assert_allclose(simulation.positions, simulation.model.rest, atol=1e-5)


def test_at_rest_nothing_pulls_and_the_organ_sleeps():
    simulation = Simulation(kidney(), return_target="implied")
    simulation.apply_force([5], [[0.0, 0.0, 1e-9]])
    for _ in range(60):
        simulation.step()
    assert simulation.asleep
    assert np.abs(simulation.positions - simulation.model.rest).max() < 1e-9


def test_without_it_nothing_is_prepared():
    model = assemble(kidney())
    assert model.spokes is None
    assert model.return_target is model.rest


@pytest.mark.parametrize(
    ("choice", "message"),
    [
        ({"return_target": "home"}, "unknown return target 'home'; choose one of rest, implied"),
        ({"return_target": "implied", "model": "surface"}, "surface model has no skeleton"),
        ({"return_target": "implied", "local_region": "auto"}, "not auto"),
    ],
)
def test_what_does_not_go_together_is_refused(choice, message):
    with pytest.raises(UserError, match=message):
        Simulation(ball(), **choice)
