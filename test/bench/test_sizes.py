"""One body at several point counts: what carries loads and displacements between its surfaces."""

import numpy as np
import pytest

from helpers.scenes import ball, filled, kidney
from tissue_sim.bench.sizes import at_size, divided, interpolation, reassembled, sized
from tissue_sim.organ.normals import triangle_area
from tissue_sim.organ.surfaces.surface_distance import distance_to_surface
from tissue_sim.organ.topology import node_area

COARSE, FINE = ball(2), ball(3)
DIVIDED = reassembled(COARSE, *divided(COARSE.surface_positions, COARSE.surface_triangles, 700), 0)
MATRIX = np.array([[0.02, 0.01, 0.0], [-0.01, 0.03, 0.02], [0.0, 0.01, -0.02]])


def bump(organ, towards=(0.3, 0.2, 0.9), total=0.3):
    """A smooth push on one side of the ball, by area, `total` N in all."""
    unit = organ.surface_positions / np.linalg.norm(organ.surface_positions, axis=1, keepdims=True)
    towards = np.array(towards) / np.linalg.norm(towards)
    weight = np.maximum(unit @ towards - 0.6, 0.0) ** 2 * node_area(organ.surface_positions, organ.surface_triangles)
    return total * weight[:, None] / weight.sum() * np.array([0.1, -0.2, -1.0])


@pytest.mark.parametrize(("source", "target"), [(COARSE, FINE), (FINE, COARSE)], ids=["finer", "coarser"])
def test_interpolation_carries_linear_fields_to_the_nearest_place(source, target):
    carry = interpolation(source, target)
    np.testing.assert_allclose(carry.sum(axis=1), 1.0, rtol=1e-12)
    assert carry.data.min() >= 0.0
    # Off by no more than the surfaces are apart.
    apart = np.linalg.norm(carry @ source.surface_positions - target.surface_positions, axis=1)
    assert apart.max() < 0.05 * 0.03
    off = carry @ (source.surface_positions @ MATRIX) - target.surface_positions @ MATRIX
    assert np.abs(off).max() < 0.05 * 0.05 * 0.03


def test_own_points_take_everything_as_it_is():
    size = sized(FINE, FINE)
    force = bump(FINE)
    np.testing.assert_array_equal(size.forces(force), force)
    np.testing.assert_array_equal(size.displacement(force), force)


@pytest.mark.parametrize(("organ", "reference"), [(COARSE, FINE), (DIVIDED, COARSE)], ids=["coarser", "finer"])
def test_force_is_the_same_in_all_and_acts_at_the_same_place(organ, reference):
    size = sized(organ, reference)
    force = bump(reference)
    carried = size.forces(force)
    np.testing.assert_allclose(carried.sum(axis=0), force.sum(axis=0), rtol=1e-9)
    moment = np.cross(reference.surface_positions, force).sum(axis=0)
    found = np.cross(organ.surface_positions, carried).sum(axis=0)
    assert np.linalg.norm(found - moment) < 0.05 * np.linalg.norm(np.linalg.norm(force, axis=1)) * 0.03


def test_coarser_surface_does_the_same_work():
    size = sized(COARSE, FINE)
    force, displacement = bump(FINE), COARSE.surface_positions @ MATRIX
    assert np.vdot(size.forces(force), displacement) == pytest.approx(np.vdot(force, size.displacement(displacement)))


def test_finer_surface_takes_the_traction_that_the_reference_takes():
    """To finite elements it is the same load: their work on any linear displacement is the same."""
    size = sized(DIVIDED, COARSE)
    traction, wanted = (
        force / node_area(organ.surface_positions, organ.surface_triangles)[:, None]
        for organ, force in ((DIVIDED, size.forces(bump(COARSE))), (COARSE, bump(COARSE)))
    )
    np.testing.assert_allclose(traction[: COARSE.n_surface], wanted, atol=1e-9 * np.abs(wanted).max())
    np.testing.assert_allclose(traction, size.reached(wanted), atol=1e-9 * np.abs(wanted).max())


def test_finer_surface_is_the_same_polyhedron():
    assert DIVIDED.n_surface == 700
    assert len(DIVIDED.surface_triangles) == 2 * 700 - 4
    np.testing.assert_array_equal(DIVIDED.surface_positions[: COARSE.n_surface], COARSE.surface_positions)
    apart = distance_to_surface(DIVIDED.surface_positions, COARSE.surface_positions, COARSE.surface_triangles)
    assert np.abs(apart).max() < 1e-12
    assert DIVIDED.volume == pytest.approx(COARSE.volume, rel=1e-12)
    longest = [
        np.linalg.norm(np.diff(organ.surface_positions[organ.surface_triangles], axis=1), axis=2).max()
        for organ in (COARSE, DIVIDED)
    ]
    assert longest[1] == pytest.approx(0.5 * longest[0])


@pytest.mark.parametrize("organ", [COARSE, kidney()], ids=["ball", "kidney"])
def test_finer_surface_is_held_at_the_same_places(organ):
    surface = divided(organ.surface_positions, organ.surface_triangles, 3 * organ.n_surface)
    finer = reassembled(organ, *surface, 0)
    assert set(organ.fixed) <= set(finer.fixed)
    area = []
    for one in (organ, finer):
        held = np.isin(one.surface_triangles, one.fixed).all(axis=1)
        area.append(triangle_area(one.surface_positions, one.surface_triangles)[held].sum())
    assert area[0] > 0.0
    assert area[1] == pytest.approx(area[0], rel=1e-9)


def test_organ_assembled_anew_keeps_clamp_tissue_and_atoms():
    organ = filled(kidney(), 20)
    remade = reassembled(organ, organ.surface_positions, organ.surface_triangles, 20)
    np.testing.assert_array_equal(remade.fixed, organ.fixed)
    np.testing.assert_array_equal(remade.spring_stiffness, organ.spring_stiffness)
    assert (remade.n_interior, remade.n_atoms, remade.youngs_modulus) == (20, organ.n_atoms, organ.youngs_modulus)
    other = reassembled(COARSE, FINE.surface_positions, FINE.surface_triangles, 0)
    assert other.surface_positions[other.fixed, 2].max() < -0.5 * 0.03
    assert len(other.fixed) / other.n_surface == pytest.approx(len(COARSE.fixed) / COARSE.n_surface, rel=0.5)


@pytest.mark.slow
def test_body_at_another_size_is_the_same_body(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    other = at_size(FINE, 400)
    assert other.n_surface == 400
    assert other.volume == pytest.approx(FINE.volume, rel=0.02)
    apart = interpolation(other, FINE) @ other.surface_positions - FINE.surface_positions
    assert np.linalg.norm(apart, axis=1).mean() < 0.01 * 0.03
    kept = list((tmp_path / "tissue_sim").glob("size-*.npz"))
    assert len(kept) == 1
    np.testing.assert_array_equal(at_size(FINE, 400).surface_positions, other.surface_positions)
