"""Inclusions: what is inside them, and how much stiffer springs and cells become."""

import json

import numpy as np
import pytest
import trimesh

from helpers.scenes import ball
from tissue_sim.errors import UserError
from tissue_sim.organ.cell_mesh import quality_of, with_cells
from tissue_sim.organ.inclusions import (
    Inclusion,
    cell_factors,
    inclusions_of,
    spring_factors,
    stiffness_at,
    with_inclusions,
)
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.placement import placed
from tissue_sim.organ.reporting.description import describe
from tissue_sim.organ.topology import assemble_like


def sphere(radius, middle=(0.0, 0.0, 0.0), stiffness=5.0):
    made = trimesh.creation.icosphere(subdivisions=3, radius=radius)
    return Inclusion(np.asarray(made.vertices) + middle, made.faces.astype(np.int32), stiffness)


def test_the_tissue_is_stiffer_inside_and_what_overlaps_is_the_last_ones():
    points = np.array([[[0.0, 0.0, 0.0], [0.02, 0.0, 0.0]], [[0.009, 0.0, 0.0], [0.012, 0.0, 0.0]]])
    both = [sphere(0.01), sphere(0.004, (0.01, 0.0, 0.0), 0.5)]
    np.testing.assert_array_equal(stiffness_at(both, points), [[5.0, 1.0], [0.5, 0.5]])
    np.testing.assert_array_equal(stiffness_at([], points), np.ones((2, 2)))


def test_parts_of_a_spring_are_in_series():
    ends = np.array([[[0.0, 0.0, 0.0], [0.02, 0.0, 0.0]], [[0.02, 0.0, 0.0], [0.03, 0.0, 0.0]]])
    found = spring_factors([sphere(0.01)], ends)
    np.testing.assert_allclose(found, [1.0 / (0.5 / 5.0 + 0.5), 1.0], rtol=1e-12)


def test_cells_are_as_stiff_as_what_they_are_made_of_in_the_mean():
    organ = with_cells(assemble_like(ball(2), interior_atoms=60))
    points, cells = organ.rest_positions, organ.cell_nodes
    one = sphere(0.012, (0.004, 0.0, -0.002))
    factors = cell_factors([one], points, cells)
    assert factors.min() == 1.0
    assert factors.max() <= 5.0
    volume = np.abs(quality_of(points, cells)[0])
    stiffer = float(volume @ (factors - 1.0)) / 4.0
    assert stiffer == pytest.approx(4.0 / 3.0 * np.pi * 0.012**3, rel=0.02)


def test_an_organ_with_one_has_stiffer_springs_and_cells_and_is_otherwise_the_same():
    plain, one = ball(2), sphere(0.012)
    organ = assemble_like(plain, inclusions=[one])
    through = spring_factors([one], plain.rest_positions[plain.spring_nodes])
    np.testing.assert_allclose(organ.spring_stiffness, plain.spring_stiffness * through, rtol=1e-12)
    assert through.max() > 2.0
    np.testing.assert_array_equal(organ.rest_positions, plain.rest_positions)
    soft, stiff = (with_cells(assemble_like(this, interior_atoms=60)) for this in (plain, organ))
    factors = cell_factors([one], stiff.rest_positions, stiff.cell_nodes)
    np.testing.assert_allclose(stiff.cell_mu, soft.cell_mu * factors, rtol=1e-12)
    np.testing.assert_allclose(stiff.cell_lambda, soft.cell_lambda * factors, rtol=1e-12)


def test_the_file_holds_them_and_one_without_is_what_it_was(tmp_path):
    both = [sphere(0.01), sphere(0.004, (0.012, 0.0, 0.0), 0.5)]
    organ = with_inclusions(ball(2), both)
    organ.save(tmp_path / "organ.npz")
    read = Organ.load(tmp_path / "organ.npz")
    assert read.digest() == organ.digest() != ball(2).digest()
    for found, wanted in zip(inclusions_of(read), both, strict=True):
        np.testing.assert_allclose(found.positions[found.triangles], wanted.positions[wanted.triangles])
        assert found.stiffness == wanted.stiffness
    without = with_inclusions(read, [])
    assert without.digest() == ball(2).digest()
    assert without.to_bytes() == ball(2).to_bytes()
    with np.load(tmp_path / "organ.npz") as stored:
        assert json.loads(str(stored["header"]))["schema_version"] == 5
    ball(2).save(tmp_path / "plain.npz")
    with np.load(tmp_path / "plain.npz") as stored:  # which older versions can read
        assert json.loads(str(stored["header"]))["schema_version"] == 4
        assert not any(name.startswith("inclusion_") for name in stored)


def test_they_go_where_the_organ_is_placed():
    organ = with_inclusions(ball(2), [sphere(0.01)])
    there = placed(organ, [0.1, 0.0, 0.0])
    np.testing.assert_allclose(there.inclusion_positions, organ.inclusion_positions + [0.1, 0.0, 0.0])


def test_info_tells_size_place_and_depth():
    organ = with_inclusions(ball(3), [sphere(0.01, (0.0, 0.0, 0.012))])
    (described,) = describe(organ)["inclusions"]
    assert described["times_as_stiff"] == 5.0
    assert described["volume_ml"] == pytest.approx(4.19, rel=0.02)
    np.testing.assert_allclose(described["middle_mm"], [0.0, 0.0, 12.0], atol=1e-6)
    assert described["least_depth_mm"] == pytest.approx(8.0, abs=0.5)
    assert "inclusions" not in describe(ball(2))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"stiffness": 0.0}, "outside 0.001..1000"),
        ({"stiffness": np.nan}, "outside 0.001..1000"),
        ({"triangles": sphere(0.01).triangles[1:]}, "inclusion 0 of organ"),
        ({"triangles": sphere(0.01).triangles[:, ::-1]}, "inclusion 0 of organ"),
    ],
)
def test_what_is_no_inclusion_is_refused(change, said):
    with pytest.raises(UserError, match=said):
        with_inclusions(ball(2), [sphere(0.01)._replace(**change)])
