"""Spheres pressed into finite elements, against Hertz and against what holds the solid."""

import numpy as np
import pytest

from helpers.blocks import box
from tissue_sim.calibration.squeeze import squeezed

E, NU = 3000.0, 0.3
RADIUS, DEPTH = 0.02, 6e-4  # m


@pytest.fixture(scope="module")
def block():
    """A block of 60 x 60 x 30 mm, fine below the middle of its top, held at its foot; and the nodes of its top."""
    across = 0.03 * np.linspace(-1.0, 1.0, 13) ** 3
    across = np.unique(np.concatenate([across, np.linspace(-0.004, 0.004, 9)]).round(6))
    up = -np.array([0.0, 0.001, 0.002, 0.004, 0.008, 0.015, 0.03])[::-1]
    solid = box(across, across, up, E, NU)
    solid.held[solid.nodes[:, 2] < -0.03 + 1e-9] = True
    return solid, np.flatnonzero(solid.nodes[:, 2] > -1e-9)


def above(depths):
    return np.array([[[0.0, 0.0, RADIUS - depth]] for depth in depths])


def test_a_sphere_is_pushed_back_as_hertz_has_it(block):
    """F = 4/3 E / (1 - nu^2) sqrt(R) d^1.5, times (1 - nu) ln(3 - 4 nu) / (1 - 2 nu) where it sticks (Spence 1968).

    And a share of sqrt(R d) over the block's height more, as its foot is bonded (Dimitriadis et al. 2002).
    """
    depths = DEPTH * np.arange(1, 7) / 6.0
    steps = squeezed(*block, above(depths), RADIUS)
    force = np.array([step.forces[0, 2] for step in steps])
    assert all(step.settled for step in steps)
    sticking = (1.0 - NU) * np.log(3.0 - 4.0 * NU) / (1.0 - 2.0 * NU)
    share = 2.0 / np.pi * (1.2876 - 1.4678 * NU + 1.3442 * NU**2) / (1.0 - NU) * np.sqrt(RADIUS * depths) / 0.03
    wanted = (1.0 + share + share**2) * sticking * 4.0 / 3.0 * E / (1.0 - NU**2) * np.sqrt(RADIUS) * depths**1.5
    assert -force == pytest.approx(wanted, rel=0.04)
    assert np.abs(steps[-1].forces[0, :2]).max() < 0.03 * -force[-1]  # the mesh is not symmetric


def test_what_the_spheres_push_with_is_what_the_foot_holds(block):
    solid, top = block
    paths = above([DEPTH]).repeat(2, axis=1)
    paths[:, 1, 0] = 0.03  # a second one at the edge
    (step,) = squeezed(solid, top, paths, RADIUS)
    inner = solid.energy(step.displacement)[1]
    assert solid.ties.max() == 0.0
    assert inner[solid.held].reshape(-1, 3).sum(axis=0) == pytest.approx(-step.forces.sum(axis=0), abs=1e-6)
    assert step.forces[:, 2].max() < 0.0


def test_a_sphere_that_goes_away_is_let_go(block):
    down = squeezed(*block, above([DEPTH, 0.5 * DEPTH, -1e-4]), RADIUS)
    assert [step.settled for step in down] == [True, True, True]
    assert len(down[0].touching) > len(down[1].touching) > len(down[2].touching) == 0
    assert np.abs(down[2].displacement).max() < 1e-9
    assert not down[2].forces.any()
