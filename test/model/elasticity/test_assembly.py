"""The three variants of the paper, cells, and the geometry they are assembled with."""

import numpy as np
import pytest
import trimesh

from helpers.scenes import RADIUS, assembled, ball, kidney
from tissue_sim.errors import UserError
from tissue_sim.model.elasticity.assembly import MODEL_NAMES, assemble, curvature_at_edges, model_of
from tissue_sim.model.elasticity.cells import cells_of
from tissue_sim.model.simulation import Simulation
from tissue_sim.organ.cell_mesh import with_cells
from tissue_sim.organ.organ import Organ, SpringKind


def mass_of(model):
    return np.sum(1.0 / model.inverse_mass[model.moving])


@pytest.mark.parametrize("variant", MODEL_NAMES)
def test_every_variant_weighs_the_whole_organ(variant):
    organ = with_cells(ball(held=False))
    assert mass_of(assemble(organ, variant)) == pytest.approx(organ.mass.sum(), rel=1e-12)
    assert organ.mass.sum() == pytest.approx(organ.density * organ.volume, rel=1e-12)


@pytest.mark.parametrize("variant", MODEL_NAMES)
def test_every_variant_decays_at_the_same_rate(variant):
    organ = with_cells(ball())
    model = assemble(organ, variant)
    rate = (model.damping * model.inverse_mass)[model.moving]
    np.testing.assert_allclose(rate, organ.damping[0] / organ.mass[0], rtol=1e-12)


def test_hybrid_has_every_spring_and_surface_only_the_edges():
    organ = ball()
    hybrid, surface = assemble(organ, "hybrid"), assemble(organ, "surface")
    assert len(hybrid.spring_first) == len(organ.spring_nodes)
    assert len(surface.spring_first) == np.count_nonzero(organ.spring_kind == SpringKind.EDGE)
    assert max(surface.spring_first.max(), surface.spring_second.max()) < organ.n_surface
    np.testing.assert_array_equal(surface.spring_stiffness, organ.spring_stiffness[organ.spring_kind == 0])
    assert len(surface.angular_nodes) == len(hybrid.angular_nodes) == len(organ.angular_nodes)


def test_volume_springs_fill_the_organ():
    """Each tetrahedron gives E V to every one of its six edges: k l^2 adds up to six times E times the volume."""
    organ = ball(2, held=False)
    model = assemble(organ, "volume")
    assert len(model.angular_nodes) == 0
    total = np.sum(model.spring_stiffness * model.spring_rest_length**2)
    assert total == pytest.approx(6.0 * organ.youngs_modulus * organ.volume, rel=1e-9)
    length = np.linalg.norm(model.rest[model.spring_first] - model.rest[model.spring_second], axis=1)
    np.testing.assert_allclose(model.spring_rest_length, length, rtol=1e-12)
    assert set(map(tuple, organ.spring_nodes[organ.spring_kind == 0])) <= {
        tuple(sorted(pair)) for pair in zip(model.spring_first.tolist(), model.spring_second.tolist(), strict=True)
    }


def test_volume_springs_of_the_kidney_stay_inside_it():
    """The kidney is not convex: tetrahedra across the hilum are left out."""
    organ = kidney()
    model = assembled(organ, "volume")
    total = np.sum(model.spring_stiffness * model.spring_rest_length**2) / (6.0 * organ.youngs_modulus)
    assert total == pytest.approx(organ.volume, rel=0.03)
    hull = trimesh.PointCloud(organ.surface_positions).convex_hull.volume
    assert hull > 1.04 * organ.volume
    assert np.all(model.spring_stiffness > 0.0)


def test_volume_model_without_interior_points_is_refused():
    organ = ball()
    edges = organ.spring_kind == SpringKind.EDGE
    n = organ.n_surface
    hollow = Organ(
        name="shell",
        surface_positions=organ.surface_positions,
        surface_triangles=organ.surface_triangles,
        atom_positions=np.empty((0, 3)),
        atom_radius=np.empty(0),
        atom_parent=np.empty(0),
        interior_positions=np.empty((0, 3)),
        interior_spoke=np.empty((0, 2)),
        fixed=organ.fixed,
        mass=organ.mass[:n],
        damping=organ.damping[:n],
        return_stiffness=organ.return_stiffness[:n],
        spring_nodes=organ.spring_nodes[edges],
        spring_rest_length=organ.spring_rest_length[edges],
        spring_stiffness=organ.spring_stiffness[edges],
        spring_kind=organ.spring_kind[edges],
        angular_nodes=organ.angular_nodes,
        angular_stiffness=organ.angular_stiffness,
    )
    assert len(assemble(hollow, "surface").moving) == n - len(organ.fixed)
    with pytest.raises(UserError, match=r"shell.*interior points.*--atoms"):
        assemble(hollow, "volume")


def test_unknown_model_is_refused_by_name():
    with pytest.raises(UserError, match=r"unknown model 'jelly'.*surface, volume, hybrid"):
        assemble(ball(), "jelly")


@pytest.mark.parametrize("variant", MODEL_NAMES)
def test_fixed_nodes_do_not_move_and_the_others_do(variant):
    organ = with_cells(ball())
    simulation = Simulation(organ, model=variant)
    top = int(np.argmax(organ.surface_positions[:, 2]))
    for _ in range(50):
        simulation.apply_force([top, *organ.fixed], np.full((1 + len(organ.fixed), 3), 0.5))
        simulation.step()
    moved = np.linalg.norm(simulation.positions - organ.rest_positions, axis=1)
    assert len(organ.fixed) > 2
    assert np.all(moved[organ.fixed] == 0.0)
    assert moved[top] > 1e-4
    assert np.all(moved[assemble(organ, variant).moving] > 0.0)


def test_cells_are_those_of_the_organ_and_the_only_thing_that_resists():
    organ = with_cells(ball(2))
    model = assemble(organ, "cells")
    assert model_of(organ) == "cells"
    assert model_of(ball(2)) == "hybrid"
    assert len(model.spring_first) == len(model.angular_nodes) == len(model.return_nodes) == 0
    assert model.cell_volume.sum() == pytest.approx(organ.volume, rel=0.03)
    cells, moduli, _ = cells_of(model.tissue)
    np.testing.assert_array_equal(cells, organ.cell_nodes)
    np.testing.assert_allclose(moduli, [organ.cell_mu, organ.cell_lambda], rtol=1e-14)


def test_cells_are_refused_where_there_are_none_or_with_what_they_do_not_have():
    with pytest.raises(UserError, match=r"organ 'ball' has no cells; add them with tissue_sim calibrate"):
        assemble(ball(), "cells")
    with pytest.raises(UserError, match="frozen region supports springs only; use local region off, modal or auto"):
        Simulation(with_cells(ball()), model="cells", local_region="frozen")


def test_auto_takes_a_region_of_cells_only_where_the_whole_takes_long(monkeypatch):
    by_itself = Simulation(with_cells(ball()), local_region="auto")
    assert (by_itself.variant, by_itself.local_region) == ("cells", "off")
    assert by_itself.model.adjacency is None
    monkeypatch.setattr("tissue_sim.model.regions.region_tables.MAX_WHOLE_CELLS", len(by_itself.model.cells) - 1)
    larger = Simulation(with_cells(ball()), local_region="auto")
    assert larger.local_region == "auto"
    assert larger.model.adjacency is not None


def test_surface_variant_leaves_the_atoms_at_rest():
    model = assemble(ball(), "surface")
    assert model.moving.max() < model.n_surface
    assert np.all(model.inverse_mass[model.n_surface :] == 0.0)


# curvature -------------------------------------------------------------------------------------
def hinge(angle, turn=0.0):
    """Two triangles over an edge of 2 m on the x axis, heights 1 and 1 m, the wings bent down by angle/2 each."""
    wing = np.array([np.cos(angle / 2.0), -np.sin(angle / 2.0)])
    rest = np.array([[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.3, *wing], [-0.2, -wing[0], wing[1]]])
    return rest, np.array([[0, 1, 2, 3]])


def test_flat_sheet_has_no_curvature():
    n = 6
    x, y = np.meshgrid(np.arange(n, dtype=float), np.arange(n, dtype=float), indexing="ij")
    skewed = np.column_stack([x.ravel() + 0.3 * y.ravel(), 0.8 * y.ravel(), np.full(n * n, 0.7)])
    corner = np.array([i * n + j for i in range(1, n - 1) for j in range(1, n - 1)])
    # The diagonal of each cell, the corners beside it.
    hinges = np.column_stack([corner, corner + n + 1, corner + 1, corner + n])
    weight, bent, _ = curvature_at_edges(skewed, hinges)
    assert np.abs(bent).max() < 1e-14
    assert np.abs(weight).max() > 0.1
    np.testing.assert_allclose(weight.sum(axis=1), 0.0, atol=1e-14)
    np.testing.assert_allclose(np.einsum("hc,hcx->hx", weight, skewed[hinges]), 0.0, atol=1e-14)


@pytest.mark.parametrize("angle", [0.01, 0.3, 1.2])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_bent_hinge_measures_edge_length_times_angle(angle, sign):
    """Exactly 2 L sin(a/2), positive where convex; the two differ by 4 % at one radian."""
    rest, hinges = hinge(sign * angle)
    _, bent, length = curvature_at_edges(rest, hinges)
    assert bent[0] == pytest.approx(sign * 2.0 * 2.0 * np.sin(angle / 2.0), rel=1e-12)
    assert bent[0] == pytest.approx(sign * 2.0 * angle, rel=0.07)
    normal = np.cross(rest[1] - rest[0], rest[2] - rest[3])
    assert length[0] == pytest.approx(np.linalg.norm(normal), rel=1e-12)


def test_every_edge_of_a_ball_is_convex():
    """Edges times angles over a sphere add up to its integrated mean curvature, 8 pi R."""
    organ = ball(2)
    model = assemble(organ)
    assert np.all(model.angular_rest > 0.0)
    assert model.angular_rest.sum() == pytest.approx(8.0 * np.pi * RADIUS, rel=0.03)
