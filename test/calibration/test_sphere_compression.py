"""Spheres pressed into finite elements, against Hertz and against what holds the solid."""

import numpy as np
import pytest

from helpers.blocks import box
from helpers.scenes import ball
from tissue_sim.calibration import sphere_compression as squeeze
from tissue_sim.calibration.fem import Body
from tissue_sim.calibration.sphere_compression import TIE, Tied, compressed, own_nodes, touchable

E, NU = 3000.0, 0.3
RADIUS, DEPTH = 0.02, 6e-4  # m


def block(half, down):
    """A block of 60 x 60 x 30 mm, fine below the middle of its top, held at its foot; and the nodes of its top.

    half: where its nodes lie on one side of the middle, mm; down: and under its top.
    """
    across = 0.001 * np.array([*(-x for x in half[::-1]), 0.0, *half])
    solid = box(across, across, -0.001 * np.array([0.0, *down])[::-1], E, NU)
    solid.held[solid.nodes[:, 2] < -0.03 + 1e-9] = True
    top = np.flatnonzero((solid.nodes[:, 2] > -1e-9) & (np.abs(solid.nodes[:, :2]).max(axis=1) < 0.03 - 1e-9))
    return solid, top


@pytest.fixture(scope="module")
def coarse():
    return block([3.0, 9.0, 30.0], [1.5, 6.0, 30.0])


def above(depths):
    return np.array([[[0.0, 0.0, RADIUS - depth]] for depth in depths])


@pytest.mark.slow
def test_a_sphere_is_pushed_back_as_hertz_has_it():
    """F = 4/3 E / (1 - nu^2) sqrt(R) d^1.5, times (1 - nu) ln(3 - 4 nu) / (1 - 2 nu) where it sticks (Spence 1968).

    And a fraction of sqrt(R d) over the block's height more, as its foot is bonded (Dimitriadis et al. 2002).
    """
    depths = DEPTH * np.array([0.4, 1.0])
    fine = block([2.0, 4.0, 6.0, 10.0, 18.0, 30.0], [1.0, 2.0, 4.0, 8.0, 15.0, 30.0])
    steps = compressed(*fine, above(depths), RADIUS)
    force = np.array([step.forces[0, 2] for step in steps])
    assert all(step.settled for step in steps)
    sticking = (1.0 - NU) * np.log(3.0 - 4.0 * NU) / (1.0 - 2.0 * NU)
    fraction = 2.0 / np.pi * (1.2876 - 1.4678 * NU + 1.3442 * NU**2) / (1.0 - NU) * np.sqrt(RADIUS * depths) / 0.03
    wanted = (1.0 + fraction + fraction**2) * sticking * 4.0 / 3.0 * E / (1.0 - NU**2) * np.sqrt(RADIUS) * depths**1.5
    assert -force == pytest.approx(wanted, rel=0.04)
    assert np.abs(steps[-1].forces[0, :2]).max() < 0.03 * -force[-1]  # the mesh is not symmetric


def test_a_tied_solid_gives_way_as_its_matrix_has_it(coarse):
    solid, top = coarse
    force = np.random.default_rng(0).standard_normal(solid.nodes.shape)
    free = np.flatnonzero(~solid.held.ravel())

    def by_matrix():
        matrix = solid.stiffness.toarray() + np.diag(np.repeat(solid.ties, 3))
        found = np.zeros(force.size)
        found[free] = np.linalg.solve(matrix[np.ix_(free, free)], force.ravel()[free])
        return found

    solid.ties = np.zeros(len(solid.nodes))
    solid.ties[top[[7, 11]]] = TIE
    tied, before = Tied(solid), by_matrix()
    for stuck in ([7, 11], [3, 7, 11], [3, 4]):  # as it was factored, one more, and two released
        solid.ties = np.zeros(len(solid.nodes))
        solid.ties[top[stuck]] = TIE
        tied.retie()
        found, wanted = tied.precondition(force.reshape(-1, 1)).ravel(), by_matrix()
        assert np.linalg.norm(found - wanted) < 1e-3 * np.linalg.norm(wanted)
    assert np.linalg.norm(before - wanted) > 1e-2 * np.linalg.norm(wanted)
    tied.renew(np.zeros_like(solid.nodes))
    np.testing.assert_allclose(
        tied.precondition(force.reshape(-1, 1)).ravel(), wanted, atol=1e-4 * np.abs(wanted).max()
    )
    solid.ties = None


def test_what_the_spheres_push_with_is_what_the_foot_holds(coarse):
    solid, top = coarse
    paths = above([DEPTH]).repeat(2, axis=1)
    paths[:, 1, 0] = 0.009  # a second one near the edge
    (step,) = compressed(solid, top, paths, RADIUS)
    inner = solid.energy(step.displacement)[1]
    assert solid.ties is None
    assert inner[solid.held].reshape(-1, 3).sum(axis=0) == pytest.approx(-step.forces.sum(axis=0), abs=1e-6)
    assert step.forces[:, 2].max() < 0.0


def test_a_step_that_is_too_long_is_taken_in_parts(coarse, monkeypatch):
    whole = squeeze._Compression._settle
    asked = []

    def short_only(run, centres):
        asked.append(centres[0, 2])
        if len(asked) > 1 and asked[-1] < asked[-2] - 0.3 * DEPTH:
            asked.pop()
            run._moved = run._moved + 1.0  # what was tried must not stay
            return False
        return whole(run, centres)

    (once,) = compressed(*coarse, above([DEPTH]), RADIUS)
    monkeypatch.setattr(squeeze._Compression, "_settle", short_only)
    found = compressed(*coarse, above([0.1 * DEPTH, DEPTH]), RADIUS)
    assert [step.settled for step in found] == [True, True]
    assert len(asked) > 3
    assert found[-1].forces[0, 2] == pytest.approx(once.forces[0, 2], rel=0.05)


def test_a_sphere_that_goes_away_is_released(coarse):
    down = compressed(*coarse, above([0.4 * DEPTH, -1e-4]), RADIUS)
    assert [step.settled for step in down] == [True, True]
    assert len(down[0].touching) > len(down[1].touching) == 0
    assert np.abs(down[1].displacement).max() < 1e-9
    assert not down[1].forces.any()


def test_what_may_be_touched_is_near_the_nodes_and_not_held():
    organ = ball(2)
    apart = np.linalg.norm(organ.surface_positions - organ.surface_positions[organ.fixed[0]], axis=1)
    touched = apart < 0.6 * apart.max()
    assert touched[organ.fixed].any()
    before = touched.copy()
    solid, nodes = touchable(organ, touched)
    assert np.array_equal(touched, before)
    assert len(nodes) > 0
    assert not solid.held[nodes].any()
    free = np.setdiff1d(np.flatnonzero(touched), organ.fixed)
    reach = np.linalg.norm(solid.nodes[nodes][:, None] - organ.surface_positions[free], axis=2).min(axis=1)
    longest = np.ptp(organ.surface_positions[organ.surface_triangles], axis=1).max() * 3**0.5
    assert reach.max() < longest


def test_own_nodes_are_the_solids_nodes_on_the_triangles():
    organ = ball(2)
    body = Body(organ)
    near = organ.surface_triangles[[5, 17]]
    found = own_nodes(body, np.array([5, 17]))
    corners = organ.surface_positions[near]
    for point in body.solid.nodes[found]:  # in the plane of one of them, and between its corners
        away = [np.linalg.det(np.stack([b - point, c - point, d - point])) for b, c, d in corners]
        assert np.abs(away).min() < 1e-12
        assert np.linalg.norm(corners - point, axis=2).min() < 0.01
    assert set(near.ravel()) <= set(found)
    assert len(found) >= 2 * 6 - 3, "corners and middles of edges"
