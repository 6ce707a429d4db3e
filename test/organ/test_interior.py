"""Interior atoms lie on the spokes, spread through the volume, and hold the organ together."""

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

from helpers.scenes import RADIUS, ball, filled, kidney
from tissue_sim.errors import UserError
from tissue_sim.model.simulation import Simulation
from tissue_sim.organ.interior import distribute_interior_atoms
from tissue_sim.organ.medial import nearest_atoms
from tissue_sim.organ.organ import Organ, SpringKind
from tissue_sim.organ.topology import assemble_organ
from tissue_sim.organ.winding import inside


def parts(organ):
    return organ.surface_positions, organ.surface_triangles, organ.atom_positions


@pytest.fixture(scope="module")
def filled_kidney():
    return filled(kidney(), 150)


def test_each_lies_on_the_spoke_of_a_boundary_point():
    surface, triangles, atoms = parts(kidney())
    placed = distribute_interior_atoms(surface, triangles, atoms, 150)
    assert placed.positions.shape == (150, 3)
    medial, boundary = placed.spoke.T
    np.testing.assert_array_equal(medial, nearest_atoms(surface, atoms, 1)[0][boundary, 0])
    assert placed.fraction.min() >= 0.1
    assert placed.fraction.max() <= 0.9
    along = atoms[medial] + placed.fraction[:, None] * (surface[boundary] - atoms[medial])
    np.testing.assert_allclose(placed.positions, along, atol=1e-15)
    assert np.all(inside(placed.positions, surface, triangles))


def test_a_layer_lies_a_mean_edge_under_the_boundary_and_the_others_deeper():
    surface, triangles, atoms = parts(kidney())
    placed = distribute_interior_atoms(surface, triangles, atoms, 300, layer=0.7)
    mesh = trimesh.Trimesh(surface, triangles, process=False)
    samples = trimesh.sample.sample_surface(mesh, 200_000, seed=0)[0]
    depth = cKDTree(samples).query(placed.positions)[0] / mesh.edges_unique_length.mean()
    layer, core = depth[:210], depth[210:]
    assert np.median(layer) == pytest.approx(0.85, abs=0.15)
    assert np.percentile(layer, 95) < 1.2 < core.min()
    spacing = cKDTree(placed.positions[:210]).query(placed.positions[:210], 2)[0][:, 1]
    assert spacing.min() > 0.4 * np.median(spacing), "some crowd"
    assert np.all(inside(placed.positions, surface, triangles))


def test_an_organ_too_thin_for_a_core_has_them_all_where_there_is_room():
    organ = ball()
    placed = distribute_interior_atoms(*parts(organ), 20, layer=0.7)
    assert len(placed.positions) == 20
    with pytest.raises(UserError, match="--interior 100000 is too many"):
        distribute_interior_atoms(*parts(organ), 100_000, layer=0.7)


def test_they_spread_through_the_volume():
    """No place inside is far from all inner nodes, none crowd, and more atoms fill closer."""
    surface, triangles, atoms = parts(kidney())
    low, high = surface.min(axis=0), surface.max(axis=0)
    probes = np.random.default_rng(0).uniform(low, high, (3000, 3))
    probes = probes[inside(probes, surface, triangles)]
    farthest = []
    for count in (0, 50, 150):
        inner = np.concatenate([atoms, distribute_interior_atoms(surface, triangles, atoms, count).positions])
        farthest.append(cKDTree(np.concatenate([inner, surface])).query(probes)[0].max())
        if count:
            gaps = cKDTree(inner[len(atoms) :]).query(inner[len(atoms) :], k=2)[0][:, 1]
            assert gaps.min() > 0.5 * gaps.mean()
    assert farthest[2] < farthest[1] < farthest[0]
    assert farthest[2] < 0.7 * farthest[0]


def test_a_spoke_that_leaves_the_organ_carries_none_beyond():
    """Two balls apart, all atoms in one: the spokes to the other run through air."""
    first = trimesh.creation.icosphere(2, 0.02)
    second = trimesh.creation.icosphere(2, 0.02).apply_translation([0.034, 0.034, 0.0])
    surface = np.concatenate([first.vertices, second.vertices])
    triangles = np.concatenate([first.faces, second.faces + len(first.vertices)]).astype(np.int32)
    atoms = np.array([[0.0, -0.005, 0.0], [0.0, 0.005, 0.0]])
    placed = distribute_interior_atoms(surface, triangles, atoms, 40)
    assert np.any(placed.spoke[:, 1] >= len(first.vertices))
    assert np.all(np.linalg.norm(placed.positions, axis=1) < 0.02)


def test_impossible_counts_are_refused():
    surface, triangles, atoms = parts(ball())
    with pytest.raises(UserError, match="--interior -1 is negative"):
        distribute_interior_atoms(surface, triangles, atoms, -1)
    with pytest.raises(UserError, match=r"--interior 100000 is too many.*largest number is \d+"):
        distribute_interior_atoms(surface, triangles, atoms, 100_000)


def test_springs_join_them_with_their_medial_atom_the_surface_and_each_other(filled_kidney):
    organ = filled_kidney
    n, first = organ.n_surface, organ.n_surface + organ.n_atoms
    spokes = organ.spring_nodes[organ.spring_kind == SpringKind.SPOKE]
    virtual = organ.spring_nodes[organ.spring_kind == SpringKind.VIRTUAL]
    own = spokes[spokes[:, 0] >= n]
    np.testing.assert_array_equal(np.sort(own[:, 1]), np.arange(first, organ.n_nodes))
    np.testing.assert_array_equal(own[np.argsort(own[:, 1]), 0] - n, organ.interior_spoke[:, 0])
    inner = organ.rest_positions[n:]
    nearest = cKDTree(inner).query(organ.surface_positions, k=4)[1]
    out = spokes[spokes[:, 0] < n]
    np.testing.assert_array_equal(out[np.argsort(out[:, 0]), 1] - n, nearest[:, 0])
    for node in range(0, n, 31):
        assert sorted(virtual[virtual[:, 0] == node, 1] - n) == sorted(nearest[node, 1:])
    between = virtual[virtual[:, 0] >= n]
    assert np.all(between.max(axis=1) >= first)
    assert len(between) > 3 * organ.n_interior
    assert len(np.unique(np.sort(organ.spring_nodes, axis=1), axis=0)) == len(organ.spring_nodes)


def test_virtual_springs_among_them_carry_the_volume_between():
    """k l^2 / E is the volume of the tetrahedra around an edge; over all edges, six times the volume."""
    organ = filled(kidney(), 150)
    n = organ.n_surface
    among = (organ.spring_nodes[:, 0] >= n) & (organ.spring_kind != SpringKind.SKELETON)
    fraction = organ.spring_stiffness[among] * organ.spring_rest_length[among] ** 2 / organ.youngs_modulus
    assert 0.2 * organ.volume < fraction.sum() / 6.0 < organ.volume


def test_mass_and_file(filled_kidney, tmp_path):
    organ = filled_kidney
    assert organ.mass.sum() == pytest.approx(organ.density * organ.volume, rel=1e-12)
    assert np.all(organ.mass > 0.0)
    organ.save(tmp_path / "filled.npz")
    back = Organ.load(tmp_path / "filled.npz")
    assert back.digest() == organ.digest()
    assert (back.n_interior, back.n_nodes) == (150, 994 + 48 + 150)


@pytest.mark.parametrize("region", ["off", "frozen"])
def test_the_filled_organ_settles_under_a_load_and_comes_back(filled_kidney, region):
    organ = filled_kidney
    simulation = Simulation(organ, local_region=region)
    place = organ.surface_positions
    patch = np.argsort(np.linalg.norm(place - place[place[:, 0].argmax()], axis=1))[:19]
    forces = np.zeros((organ.n_surface, 3))
    forces[patch, 0] = -0.2 / 19
    moved, settled = simulation.settle(forces)
    assert settled
    assert 1e-4 < np.linalg.norm(moved, axis=1).max() < 5e-3
    assert simulation.settings[10] <= Simulation(kidney()).settings[10]
    for _ in range(1500):
        simulation.step()
    assert simulation.asleep


def test_one_interior_atom_beside_a_straight_skeleton_is_enough():
    mesh = trimesh.creation.icosphere(2, RADIUS)
    organ = assemble_organ(
        name="one",
        surface_positions=mesh.vertices,
        surface_triangles=mesh.faces,
        atom_positions=[[0.0, 0.0, 0.01], [0.0, 0.0, -0.01]],
        atom_radius=[0.02, 0.02],
        atom_parent=[-1, 0],
        interior_atoms=1,
    )
    assert organ.n_interior == 1
    assert np.count_nonzero(organ.spring_kind == SpringKind.SKELETON) == 1
