"""The finite-element body of an organ: loads, symmetry, equilibrium."""

from dataclasses import replace

import numpy as np
import pytest

from helpers.scenes import ball, kidney
from tissue_sim.calibration.cases import strongest
from tissue_sim.calibration.fe_mesh import Grading
from tissue_sim.calibration.fem import Body, volume_change
from tissue_sim.errors import UserError

SMALL = 1e-4  # N


def pushed(organ, newton, axis=2, inward=-1.0):
    """Forces (n_surface, 3) on the nodes of the upper cap, the same on each."""
    forces = np.zeros((organ.n_surface, 3))
    cap = organ.surface_positions[:, 2] > 0.85 * organ.surface_positions[:, 2].max()
    forces[cap, axis] = inward * newton / cap.sum()
    return forces


@pytest.fixture(scope="module")
def body():
    return Body(ball(2))


def test_loads_add_up_to_the_forces(body):
    forces = np.random.default_rng(0).normal(size=(body.organ.n_surface, 3))
    np.testing.assert_allclose(body.loads(forces).sum(axis=0), forces.sum(axis=0), atol=1e-10)
    unit = np.zeros((body.organ.n_surface, 3))
    for node in (0, 57):  # each force stays on the triangles around its node, and is centred as they are
        unit[:] = 0.0
        unit[node, 2] = 1.0
        around = np.unique(body.organ.surface_triangles[(body.organ.surface_triangles == node).any(axis=1)])
        load = body.loads(unit)[:, 2]
        span = np.ptp(body.organ.surface_positions[around], axis=0)
        centre = load @ body.filling.nodes / load.sum()
        assert np.all(np.abs(centre - body.organ.surface_positions[node]) < 0.2 * span + 1e-3)


def test_uniform_pressure_is_that_of_the_facets(body):
    """Forces A_i t make the uniform traction t, whose loads are known: a third of a facet at each of its middles."""
    organ = body.organ
    a, b, c = (organ.surface_positions[organ.surface_triangles[:, k]] for k in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2.0
    fraction = np.bincount(organ.surface_triangles.ravel(), np.repeat(area / 3.0, 3))
    found = body.loads(np.column_stack([fraction, 2.0 * fraction, 0.0 * fraction]))
    facets, nodes = body.filling.facets, body.filling.nodes
    straight = np.zeros(len(nodes))
    one, other, third = (nodes[facets[:, k]] for k in range(3))
    small = np.linalg.norm(np.cross(other - one, third - one), axis=1) / 2.0
    np.add.at(straight, facets[:, 3:].ravel(), np.repeat(small / 3.0, 3))
    corners = facets[:, :3]
    front = np.intersect1d(corners[body.filling.clamped], corners[~body.filling.clamped])
    plain = np.setdiff1d(np.arange(len(nodes)), np.unique(facets[np.isin(corners, front).any(axis=1)]))
    np.testing.assert_allclose(found[plain, 0], straight[plain], atol=1e-12)
    np.testing.assert_allclose(found[:, 1], 2.0 * found[:, 0], atol=1e-15)
    assert found[:, 0].sum() == pytest.approx(area.sum(), rel=1e-6)


def test_clamp_holds_and_the_rest_moves(body):
    found = body.settle_linear(pushed(body.organ, 0.05)[None])[0]
    held = np.zeros(body.organ.n_surface, dtype=bool)
    held[body.organ.fixed] = True
    assert not found[held].any()
    assert np.linalg.norm(found[~held], axis=1).min() > 0.0


def test_soft_body_moves_more_in_proportion(body):
    forces = pushed(body.organ, 0.05)[None]
    soft = Body(replace(body.organ, youngs_modulus=0.5 * body.organ.youngs_modulus))
    np.testing.assert_allclose(soft.settle_linear(forces), 2.0 * body.settle_linear(forces), rtol=1e-8, atol=1e-12)


def test_small_load_is_linear_and_a_large_one_is_not(body):
    organ = body.organ
    for newton, wanted in ((SMALL, pytest.approx(0.0, abs=1e-3)), (0.6, pytest.approx(0.1, abs=0.08))):
        forces = pushed(organ, newton)
        straight, settled = body.settle_linear(forces[None])[0], body.settle(forces)
        assert settled.converged
        off = np.linalg.norm(settled.displacement - straight) / np.linalg.norm(straight)
        assert off == wanted
        assert settled.volume_change == volume_change(organ, settled.displacement)
    assert np.linalg.norm(settled.displacement, axis=1).max() > 0.002
    assert -0.2 < settled.volume_change < 0.0


def test_several_loads_settle_as_each_alone(body):
    forces = [pushed(body.organ, newton) for newton in (0.02, 0.0, 0.2)]
    together = list(body.settle_many(forces))
    assert not together[1].displacement.any()
    for force, found in zip(forces, together, strict=True):
        np.testing.assert_allclose(found.displacement, body.settle(force).displacement, atol=1e-8)


def test_same_body_gives_same_answer():
    grading = Grading(clamp=0)
    forces = pushed(ball(1), 0.1)
    first, second = (Body(ball(1), grading=grading).settle(forces) for _ in range(2))
    np.testing.assert_array_equal(first.displacement, second.displacement)


@pytest.mark.extended
def test_mirrored_load_gives_mirrored_answer(body):
    """On the mirrored organ, whose mesh is another: what differs is the error of the meshes."""
    organ = body.organ
    mirror = np.array([-1.0, 1.0, 1.0])
    mirrored = replace(
        organ,
        surface_positions=organ.surface_positions * mirror,
        surface_triangles=organ.surface_triangles[:, [0, 2, 1]],
        atom_positions=organ.atom_positions * mirror,
    )
    forces = pushed(organ, 0.2, axis=0, inward=1.0) + pushed(organ, 0.1)
    wanted, other = body.settle(forces), Body(mirrored).settle(forces * mirror)
    assert wanted.converged
    assert other.converged
    off = np.linalg.norm(other.displacement * mirror - wanted.displacement) / np.linalg.norm(wanted.displacement)
    assert off < 5e-3


def test_weight_is_carried_by_the_clamp(body):
    gravity = np.array([0.5, 0.0, -9.81])
    nothing = np.zeros((1, body.organ.n_surface, 3))
    weight = body.loads(nothing[0], gravity)
    mass = body.organ.density * body.organ.volume
    np.testing.assert_allclose(weight.sum(axis=0), mass * gravity, rtol=1e-9, atol=1e-12)
    solved = body.solid.solve(weight[None])[0]
    reaction = weight - (body.solid.stiffness @ solved.ravel()).reshape(weight.shape)
    np.testing.assert_allclose(reaction[body.solid.held[:, 0]].sum(axis=0), mass * gravity, atol=1e-9)
    straight = body.settle_linear(nothing, gravity)[0]
    np.testing.assert_array_equal(straight, solved[: body.organ.n_surface])
    assert straight[np.argmax(body.organ.surface_positions[:, 2]), 2] < 0.0
    sagging = body.settle(nothing[0], 0.01 * gravity)
    assert sagging.converged
    off = np.linalg.norm(sagging.displacement - 0.01 * straight) / np.linalg.norm(0.01 * straight)
    assert off < 0.01


@pytest.mark.extended
def test_quarter_points_do_the_work_of_halvings(monkeypatch):
    """Against a mesh much finer at the clamp."""
    organ = ball(1)
    forces = pushed(organ, 0.05, axis=0)[None]
    fine = Body(organ, grading=Grading(clamp=3)).settle_linear(forces)

    def error(halvings):
        found = Body(organ, grading=Grading(clamp=halvings)).settle_linear(forces)
        return np.linalg.norm(found - fine) / np.linalg.norm(fine)

    with_them = error(1)
    monkeypatch.setattr("tissue_sim.calibration.fe_mesh.to_quarter_points", lambda nodes, pairs, front: None)
    without = [error(halvings) for halvings in (1, 2)]
    assert with_them < 0.05
    assert with_them < without[1] < without[0]


@pytest.mark.parametrize("tissue", [{"poisson_ratio": 0.5}, {"youngs_modulus": 0.0}, {"density": float("nan")}])
def test_tissue_that_is_no_solid_is_named(tissue):
    with pytest.raises(UserError, match=r"'ball'.*is not possible"):
        Body(replace(ball(1), **tissue))


@pytest.mark.slow
def test_every_load_of_a_calibration_settles_on_the_kidney():
    """Smooth and sharp patches, pushed and pulled and drawn sideways: 12 mm deep, or as strong as they get."""
    organ = kidney()
    body = Body(organ)
    rng = np.random.default_rng(8)
    x = organ.surface_positions
    away = np.flatnonzero(x[:, 2] > x[:, 2].min() + 0.025)
    forces = []
    for number, middle in enumerate(rng.choice(away, 8)):
        distance = np.linalg.norm(x - x[middle], axis=1)
        fraction = np.maximum(0.0, 1.0 - (distance / (0.011 if number % 2 else 0.005)) ** 2)
        forces.append(fraction[:, None] * rng.normal(size=3))
    loads = np.array(forces)
    depth = 0.012 / np.linalg.norm(body.settle_linear(loads), axis=2).max(axis=1)
    scale = np.minimum(depth, strongest(loads, np.ones(len(loads)), organ))
    settled = list(body.settle_many(scale[:, None, None] * loads))
    assert all(found.converged for found in settled)
    assert max(np.linalg.norm(found.displacement, axis=1).max() for found in settled) > 0.01
    assert min(found.least_det for found in settled) > 0.3
