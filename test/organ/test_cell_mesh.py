"""Cells between an organ's nodes: what they fill, how flat they may be, what is refused."""

from dataclasses import replace

import numpy as np
import pytest

from helpers.scenes import ball, kidney
from tissue_sim.bench.measured.lattice import shell
from tissue_sim.errors import UserError
from tissue_sim.organ.cell_mesh import LEAST_QUALITY, bridging, quality_of, tetrahedra, tissue_cells, with_cells
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.shipped import shipped_organ
from tissue_sim.organ.surface_checks import signed_volume
from tissue_sim.organ.topology import assemble_like, assemble_organ


def calibrated():
    """The kidney that ships, with its interior atoms."""
    return Organ.load(shipped_organ())


CORNERS = ((0, 1, 2), (0, 1, 3), (0, 2, 3), (1, 2, 3))


def faces_of(cells):
    return {tuple(sorted(face)) for corner in CORNERS for face in cells[:, corner].tolist()}


def test_a_regular_cell_has_quality_1_and_a_flat_one_0():
    regular = np.array([[1, 1, 1], [1, -1, -1], [-1, -1, 1], [-1, 1, -1]], dtype=float)
    volume, quality = quality_of(regular, np.array([[0, 1, 2, 3], [1, 0, 2, 3]]))
    assert np.abs(volume) == pytest.approx(8.0 / 3.0)
    np.testing.assert_allclose(quality[0], -quality[1])
    assert abs(quality[0]) == pytest.approx(1.0)
    flat = regular * [1.0, 1.0, 0.0]
    assert quality_of(flat, np.array([[0, 1, 2, 3]]))[1] == pytest.approx(0.0)


@pytest.mark.parametrize("organ", [ball(2), assemble_like(ball(3), interior_atoms=100), calibrated()])
def test_cells_fill_the_organ_join_every_node_and_none_is_a_sliver(organ):
    made = with_cells(organ)
    volume, quality = quality_of(made.rest_positions, made.cell_nodes)
    assert volume.min() > 0.0
    assert 0.97 < volume.sum() / organ.volume < 1.0 + 1e-9
    assert np.array_equal(np.unique(made.cell_nodes), np.arange(organ.n_nodes))
    assert (quality > LEAST_QUALITY).mean() > 0.999
    triangles = {tuple(sorted(corner)) for corner in organ.surface_triangles.tolist()}
    on_surface = sum(len(triangles & faces_of(made.cell_nodes[k : k + 1])) == 2 for k in range(len(volume)))
    assert on_surface <= 2, "a dent must turn such a cell inside out"
    missed = triangles - faces_of(tetrahedra(organ.rest_positions, organ.surface_positions, organ.surface_triangles))
    assert len(missed) < 0.01 * len(triangles)


def hairpin(gap):
    """A tube of 10 mm radius, bent so that its two limbs lie `gap` mm apart: points with its axis, surface, triangles.

    Its limbs end near x = 0, its bend begins at 60 mm, and the rings of points of the two are staggered.
    """
    radius, around = 10.0, 10
    turn = radius + 0.5 * gap
    bend = [(60.0 + turn * np.sin(t), -turn * np.cos(t), np.sin(t), -np.cos(t)) for t in np.linspace(0, np.pi, 7)]
    limb = np.linspace(0.0, 50.0, 4)
    path = np.array([(x, -turn, 0, -1) for x in limb] + bend + [(max(x - 3.7, 0.0), turn, 0, 1) for x in limb[::-1]])
    angle = 2 * np.pi * np.arange(around) / around
    out = np.cos(angle)[None, :, None] * np.pad(path[:, None, 2:], ((0, 0), (0, 0), (0, 1)))
    axis = np.pad(path[:, :2], ((0, 0), (0, 1)))
    rings = axis[:, None] + radius * (out + np.sin(angle)[None, :, None] * np.array([0.0, 0.0, 1.0]))
    surface = np.concatenate([rings.reshape(-1, 3), axis[[0, -1]] - [0.5, 0.0, 0.0]])
    k, first = np.arange(around), around * np.arange(len(path) - 1)[:, None]
    here, there = first + k, first + (k + 1) % around
    sides = np.stack([here, there, there + around, here, there + around, here + around], axis=-1).reshape(-1, 3)
    ends = len(surface) - 2, len(surface) - 1
    last = around * (len(path) - 1)
    caps = [np.stack([0 * k + ends[0], (k + 1) % around, k], axis=1)]
    caps += [np.stack([0 * k + ends[1], last + k, last + (k + 1) % around], axis=1)]
    triangles = np.concatenate([sides, *caps])
    if signed_volume(surface, triangles) < 0.0:
        triangles = triangles[:, [0, 2, 1]]
    return 1e-3 * np.concatenate([surface, axis[1:-1]]), 1e-3 * surface, triangles.astype(np.int32)


def test_no_cell_joins_two_loops_that_nearly_touch():
    """Its centroid lies inside one of them, and it would hold them together as if they had grown into each other."""
    points, surface, triangles = hairpin(3.0)

    def joined(cells):
        limb = np.where(points[:, 0] < 0.055, np.sign(points[:, 1]), 0.0)[cells]
        return np.flatnonzero((limb.min(axis=1) < 0.0) & (limb.max(axis=1) > 0.0))

    found = tetrahedra(points, surface, triangles)
    assert len(joined(found)) > 0, "without the test of edges there are some"
    assert bridging(points, found, surface, triangles)[joined(found)].all()
    left = joined(tissue_cells(points, surface, triangles, "hairpin"))
    assert len(left) < 0.1 * len(joined(found)), "those that a node would otherwise be without any cell"


def test_cells_of_an_organ_without_loops_all_stay():
    organ = calibrated()
    cells = organ.cell_nodes.astype(np.int64)
    assert not bridging(organ.rest_positions, cells, organ.surface_positions, organ.surface_triangles).any()


def test_moduli_are_those_of_the_tissue():
    organ = with_cells(ball(), (1.0, 0.5))
    e, nu = organ.youngs_modulus, organ.poisson_ratio
    np.testing.assert_allclose(organ.cell_mu, e / (2.0 * (1.0 + nu)))
    np.testing.assert_allclose(organ.cell_lambda, 0.5 * e * nu / ((1.0 + nu) * (1.0 - 2.0 * nu)))


def test_too_few_nodes_inside_are_reported_of():
    with pytest.raises(UserError, match=r"cells fill 7\d % of organ 'kidney'; build it with more --interior"):
        with_cells(kidney())


def test_a_node_that_no_cell_joins_is_reported_of():
    organ = ball()
    outside = np.concatenate([organ.rest_positions, [[0.0, 0.0, 1.0]]])
    with pytest.raises(UserError, match="no cell joins 1 nodes"):
        tissue_cells(outside, organ.surface_positions, organ.surface_triangles, "ball")


def test_a_file_keeps_cells_and_one_without_is_what_it_was(tmp_path):
    organ = with_cells(ball())
    organ.save(tmp_path / "cells.npz")
    read = Organ.load(tmp_path / "cells.npz")
    for name in ("cell_nodes", "cell_mu", "cell_lambda"):
        np.testing.assert_array_equal(getattr(read, name), getattr(organ, name))
    assert read.digest() == organ.digest() != ball().digest()
    assert replace(organ, cell_mu=2.0 * organ.cell_mu).digest() != organ.digest()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"cell_nodes": lambda cells: cells[:, [1, 0, 2, 3]]}, "without volume or inverted"),
        ({"cell_nodes": lambda cells: cells + 10_000}, "cell_nodes names a node outside"),
        ({"cell_mu": lambda mu: 0.0 * mu}, "cell_mu must be greater than 0"),
        ({"cell_lambda": lambda lam: -lam}, "cell_lambda must not be negative"),
        ({"cell_mu": lambda mu: mu[1:]}, "cell_mu has shape"),
    ],
)
def test_cells_that_make_no_sense_are_refused_by_name(change, words):
    organ = with_cells(ball())
    changed = {name: how(getattr(organ, name)) for name, how in change.items()}
    with pytest.raises(UserError, match=words):
        replace(organ, **changed)


def test_a_body_with_edges_keeps_their_cells():
    """Those of a box have two faces on the surface at a right angle; without them its edges would hang by a thread."""
    index, triangles = shell((9, 7, 6))
    surface = 0.005 * index
    atoms = np.linspace([0.008, 0.015, 0.0125], [0.032, 0.015, 0.0125], 5)
    about = {"atom_positions": atoms, "atom_radius": np.full(5, 0.0125), "atom_parent": np.arange(-1, 4)}
    made = with_cells(
        assemble_organ(
            name="box", surface_positions=surface, surface_triangles=triangles, fixed=(), interior_atoms=120, **about
        )
    )
    volume, _ = quality_of(made.rest_positions, made.cell_nodes)
    assert volume.sum() == pytest.approx(made.volume, rel=1e-3)
    alone = np.bincount(made.cell_nodes.ravel(), minlength=made.n_nodes) == 1
    assert alone.sum() <= 8, "corners at most"
