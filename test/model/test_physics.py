"""What any elastic organ does, whatever its stiffnesses: signs, scaling, symmetry, uniform strain."""

import numpy as np
import pytest
from scipy.sparse.linalg import splu

from helpers.scenes import assembled, ball, filled, kidney
from tissue_sim.model.elasticity.modes import stiffness_matrix
from tissue_sim.model.simulation import Simulation


def patch(organ, direction, count):
    """The free nodes nearest to the outermost one in a direction, and a unit force (n_surface, 3) N inwards there."""
    top = int(np.argmax(organ.surface_positions @ np.asarray(direction)))
    distance = np.linalg.norm(organ.surface_positions - organ.surface_positions[top], axis=1)
    nodes = np.setdiff1d(np.argsort(distance)[:count], organ.fixed)
    forces = np.zeros((organ.n_surface, 3))
    forces[nodes] = -np.asarray(direction) / np.linalg.norm(direction) / len(nodes)
    return nodes, forces


def settled(organ, forces, **options):
    displacement, done = Simulation(organ, **options).settle(forces, tolerance=1e-5)
    assert done
    return displacement


@pytest.mark.parametrize("model", ["surface", "volume", "hybrid"])
@pytest.mark.parametrize("organ", [ball(2), pytest.param(kidney(), marks=pytest.mark.slow)], ids=["ball", "kidney"])
def test_deeper_under_more_force_and_along_it(organ, model):
    nodes, forces = patch(organ, (0.0, 0.0, 1.0), 7)
    depths = []
    for newton in (0.01, 0.03, 0.06, 0.1):
        displacement = settled(organ, newton * forces, model=model)
        depths.append(float(-displacement[nodes, 2].mean()))
    assert depths[0] > 0.0
    assert np.all(np.diff(depths) > 0.0)


@pytest.mark.parametrize("model", ["surface", "volume", "hybrid"])
def test_small_loads_displace_in_proportion(model):
    organ = ball(2)
    _, forces = patch(organ, (0.0, 0.6, 0.8), 7)
    small, double = (settled(organ, newton * forces, model=model) for newton in (1e-4, 2e-4))
    assert np.linalg.norm(double - 2.0 * small) <= 1e-3 * np.linalg.norm(double)


@pytest.mark.parametrize("model", ["surface", "volume", "hybrid"])
def test_twice_as_stiff_tissue_under_twice_the_load_settles_the_same(model):
    """All stiffnesses are proportional to Young's modulus, so with large displacements too."""
    soft, stiff = ball(2), ball(2, youngs_modulus=20_000.0)
    _, forces = patch(soft, (0.0, 0.0, 1.0), 7)
    one, two = settled(soft, 0.3 * forces, model=model), settled(stiff, 0.6 * forces, model=model)
    assert np.abs(one).max() > 7e-4  # where springs have turned
    assert np.linalg.norm(one - two) <= 1e-3 * np.linalg.norm(one)


def test_mirrored_load_gives_the_mirrored_answer():
    organ = ball(2, turned=False)  # the plane y = 0 cuts it into mirror images, its nodes, springs and held cap too
    surface, mirror = organ.surface_positions, np.array([1.0, -1.0, 1.0])
    image = np.argmin(np.linalg.norm(surface[:, None] * mirror - surface[None], axis=2), axis=1)
    np.testing.assert_allclose(surface[image], surface * mirror, atol=1e-12)
    _, forces = patch(organ, (0.3, 0.7, 0.6), 7)
    forces *= 0.4
    reflected = np.zeros_like(forces)
    reflected[image] = forces * mirror
    here, there = settled(organ, forces), settled(organ, reflected)
    assert np.abs(here[:, 1]).max() > 7e-4
    assert np.linalg.norm(there[image] - here * mirror) <= 1e-3 * np.linalg.norm(here)


def test_inside_follows_a_uniform_strain_of_the_surface():
    """Patch test of the springs: with every surface node led by x -> A x, the inner nodes find their place by A too.

    A network of springs is no continuum, so an inner node that springs join from unlike sides is a little off.
    """
    organ = filled(ball(3), 150)
    model = assembled(organ)
    strain = np.array([[0.010, 0.004, 0.0], [0.004, -0.006, 0.002], [0.0, 0.002, 0.008]])
    wanted = organ.rest_positions @ strain
    n, led = organ.n_nodes, np.arange(3 * organ.n_surface)
    inner = np.arange(3 * organ.n_surface, 3 * n)
    # Without return springs, which pull to rest whatever the surface does.
    stiffness = stiffness_matrix(model._replace(return_stiffness=np.zeros(n))).tocsc()
    answer = splu(stiffness[inner][:, inner]).solve(-stiffness[inner][:, led] @ wanted.ravel()[led]).reshape(-1, 3)
    assert np.linalg.norm(answer - wanted[organ.n_surface :]) <= 0.15 * np.linalg.norm(wanted[organ.n_surface :])
