"""The hybrid topology: which springs there are, how stiff, and what everything weighs."""

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

from helpers.scenes import RADIUS, ball, kidney
from tissue_sim.errors import UserError
from tissue_sim.organ.normals import triangle_area
from tissue_sim.organ.organ import SpringKind
from tissue_sim.organ.springs import NEAREST_ATOMS, SHELL_THICKNESS, surface_edges
from tissue_sim.organ.topology import (
    DAMPING_RATE,
    assemble_organ,
)

EDGE, SPOKE, VIRTUAL, SKELETON = SpringKind


def springs(organ, kind):
    return organ.spring_nodes[organ.spring_kind == kind]


def test_kidney_has_the_counts_of_the_paper():
    """994 boundary points, 48 atoms, each point joined with its four nearest atoms."""
    organ = kidney()
    assert organ.n_surface == 994
    assert len(organ.surface_triangles) == 1984
    assert organ.n_atoms == 48
    assert len(springs(organ, EDGE)) == len(organ.angular_nodes) == 2976
    assert len(springs(organ, SPOKE)) == 994
    assert len(springs(organ, VIRTUAL)) == 3 * 994
    assert len(springs(organ, SKELETON)) == 47


@pytest.mark.parametrize("organ", [ball(2), kidney()], ids=["ball", "kidney"])
class TestOrgan:
    def test_surface_is_a_ball_in_topology(self, organ):
        assert organ.n_surface - len(springs(organ, EDGE)) + len(organ.surface_triangles) == 2

    def test_springs_are_stored_by_kind(self, organ):
        assert np.all(np.diff(organ.spring_kind) >= 0)

    def test_edge_springs_are_the_triangles_edges(self, organ):
        t = organ.surface_triangles
        sides = np.sort(np.concatenate([t[:, [0, 1]], t[:, [1, 2]], t[:, [2, 0]]]), axis=1)
        expected = np.unique(sides, axis=0)
        np.testing.assert_array_equal(np.unique(np.sort(springs(organ, EDGE), axis=1), axis=0), expected)
        assert len(springs(organ, EDGE)) == len(expected)

    def test_each_spoke_is_the_nearest_atom(self, organ):
        spokes = springs(organ, SPOKE)
        np.testing.assert_array_equal(np.sort(spokes[:, 0]), np.arange(organ.n_surface))
        distance = np.linalg.norm(organ.surface_positions[spokes[:, 0], None] - organ.atom_positions[None], axis=2)
        np.testing.assert_array_equal(spokes[:, 1] - organ.n_surface, distance.argmin(axis=1))

    def test_virtual_springs_are_the_next_three_nearest(self, organ):
        virtual = springs(organ, VIRTUAL)
        _, nearest = cKDTree(organ.atom_positions).query(organ.surface_positions, k=NEAREST_ATOMS)
        for node in range(0, organ.n_surface, 7):
            atoms = virtual[virtual[:, 0] == node, 1] - organ.n_surface
            assert sorted(atoms) == sorted(nearest[node, 1:])

    def test_skeleton_springs_join_parents(self, organ):
        bones = springs(organ, SKELETON) - organ.n_surface
        child = bones.max(axis=1)
        np.testing.assert_array_equal(np.sort(child), np.flatnonzero(organ.atom_parent >= 0))
        np.testing.assert_array_equal(bones.min(axis=1), organ.atom_parent[child])

    def test_springs_are_at_rest(self, organ):
        first, second = organ.rest_positions[organ.spring_nodes].transpose(1, 0, 2)
        np.testing.assert_allclose(organ.spring_rest_length, np.linalg.norm(second - first, axis=1), rtol=1e-12)

    def test_organ_weighs_density_times_volume(self, organ):
        mesh = trimesh.Trimesh(organ.surface_positions, organ.surface_triangles, process=False)
        assert organ.mass.sum() == pytest.approx(organ.density * mesh.volume, rel=1e-12)
        assert organ.mass[: organ.n_surface].sum() == pytest.approx(0.45 * organ.mass.sum(), rel=1e-12)
        assert np.all(organ.mass > 0.0)
        np.testing.assert_allclose(organ.damping, DAMPING_RATE * organ.mass, rtol=1e-12)

    def test_surface_mass_follows_the_area(self, organ):
        mesh = trimesh.Trimesh(organ.surface_positions, organ.surface_triangles, process=False)
        fraction = np.zeros(organ.n_surface)
        np.add.at(fraction, organ.surface_triangles, mesh.area_faces[:, None] / 3.0)
        surface = organ.mass[: organ.n_surface]
        np.testing.assert_allclose(surface / surface.sum(), fraction / mesh.area, rtol=1e-9)

    def test_edge_springs_are_van_gelders(self, organ):
        """k = E h sum(A) / l^2, triangle by triangle."""
        kind = organ.spring_kind == EDGE
        length = organ.spring_rest_length[kind]
        area = {}
        for triangle in organ.surface_triangles:
            a, b, c = organ.surface_positions[triangle]
            for one, other in ((0, 1), (1, 2), (2, 0)):
                side = frozenset((int(triangle[one]), int(triangle[other])))
                area[side] = area.get(side, 0.0) + 0.5 * np.linalg.norm(np.cross(b - a, c - a))
        sums = np.array([area[frozenset(map(int, pair))] for pair in springs(organ, EDGE)])
        expected = organ.youngs_modulus * SHELL_THICKNESS * length.mean() * sums / length**2
        np.testing.assert_allclose(organ.spring_stiffness[kind], expected, rtol=1e-9)

    def test_columns_share_the_stiffness_of_the_tissue_under_a_node(self, organ):
        """Four springs in the ratio 1/L^2; E A / L each, were it alone, by the mean of free and confined tissue."""
        columns = organ.spring_kind == SPOKE
        columns |= organ.spring_kind == VIRTUAL
        node, length = organ.spring_nodes[columns, 0], organ.spring_rest_length[columns]
        stiffness = organ.spring_stiffness[columns]
        nu = organ.poisson_ratio
        modulus = organ.youngs_modulus * np.sqrt((1.0 - nu) / ((1.0 + nu) * (1.0 - 2.0 * nu)))
        area = np.zeros(organ.n_surface)
        for corner in range(3):
            fraction = triangle_area(organ.surface_positions, organ.surface_triangles) / 3.0
            np.add.at(area, organ.surface_triangles[:, corner], fraction)
        weight = 1.0 / length
        total = np.bincount(node, weights=weight)
        np.testing.assert_allclose(stiffness, modulus * area[node] / length * weight / total[node], rtol=1e-9)

    def test_angular_springs_sit_on_every_edge_with_its_corners(self, organ):
        triangles = {frozenset(map(int, t)): t for t in organ.surface_triangles}
        for i, j, k, m in organ.angular_nodes[::5]:
            for corner, first, second in ((k, i, j), (m, j, i)):
                around = triangles[frozenset((int(first), int(second), int(corner)))]
                place = list(around).index(first)
                assert around[(place + 1) % 3] == second  # this triangle runs along its direction of the edge
        np.testing.assert_array_equal(
            np.unique(np.sort(organ.angular_nodes[:, :2], axis=1), axis=0),
            np.unique(np.sort(springs(organ, EDGE), axis=1), axis=0),
        )
        assert np.all(organ.angular_stiffness > 0.0)


def test_held_nodes_of_the_kidney_are_its_back():
    organ = kidney()
    y = organ.surface_positions[:, 1]
    np.testing.assert_array_equal(organ.fixed, np.flatnonzero(y > y.min() + 0.9 * np.ptp(y)))


def test_stiffness_is_in_proportion_to_youngs_modulus():
    soft, stiff = ball(), ball(youngs_modulus=30_000.0)
    for name in ("spring_stiffness", "angular_stiffness", "return_stiffness"):
        np.testing.assert_allclose(getattr(stiff, name), 3.0 * getattr(soft, name), rtol=1e-12)
    np.testing.assert_allclose(stiff.mass, soft.mass, rtol=1e-12)


def test_plate_of_the_same_bending_stiffness_has_the_same_angular_springs():
    """3 D / A with D = E h^3 / (12 (1 - nu^2)): twice as large in every direction, twice as stiff."""
    organ = ball()
    _, _, area = surface_edges(organ.surface_triangles, triangle_area(organ.surface_positions, organ.surface_triangles))
    edges = organ.spring_rest_length[organ.spring_kind == EDGE]
    rigidity = organ.youngs_modulus * (SHELL_THICKNESS * edges.mean()) ** 3 / (12.0 * (1.0 - organ.poisson_ratio**2))
    np.testing.assert_allclose(organ.angular_stiffness, 3.0 * rigidity / area, rtol=1e-12)


def test_few_atoms_give_fewer_virtual_springs():
    mesh = trimesh.creation.icosphere(1, RADIUS)
    organ = assemble_organ(
        name="two atoms",
        surface_positions=mesh.vertices,
        surface_triangles=mesh.faces,
        atom_positions=[[0.0, 0.0, 0.01], [0.0, 0.0, -0.01]],
        atom_radius=[0.02, 0.02],
        atom_parent=[-1, 0],
    )
    assert [len(springs(organ, kind)) for kind in SpringKind] == [120, 42, 42, 1]


def make(**changes):
    mesh = trimesh.creation.icosphere(1, RADIUS)
    parts = {
        "name": "lump",
        "surface_positions": mesh.vertices,
        "surface_triangles": mesh.faces,
        "atom_positions": [[0.0, 0.0, 0.01], [0.0, 0.0, -0.01]],
        "atom_radius": [0.02, 0.02],
        "atom_parent": [-1, 0],
    }
    return assemble_organ(**(parts | changes))


SPHERE = trimesh.creation.icosphere(1, RADIUS)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"youngs_modulus": 0.0}, "Young's modulus 0 Pa is outside"),
        ({"youngs_modulus": float("nan")}, "Young's modulus nan Pa"),
        ({"poisson_ratio": 0.5}, "Poisson's ratio 0.5 is outside"),
        ({"density": -1.0}, "density -1 kg"),
        ({"atom_positions": np.zeros((0, 3)), "atom_radius": [], "atom_parent": []}, "no medial atoms.*--atoms"),
        ({"atom_positions": [[0.0, 0.0, 0.01], [0.0, 0.0, 0.01]]}, "atoms coincide"),
        ({"atom_positions": [[0.0, 0.0, 0.01], SPHERE.vertices[3]]}, "atom lies on the surface"),
        ({"surface_triangles": SPHERE.faces[1:]}, "open"),
        ({"surface_triangles": SPHERE.faces[:, ::-1]}, "inverted"),
        ({"fixed": [42]}, "fixed names a node"),
        ({"fixed": [-1]}, "fixed names a node"),
    ],
)
def test_what_makes_no_organ_is_refused(changes, message):
    with pytest.raises(UserError, match=message):
        make(**changes)


def test_triangles_without_area_are_refused():
    mesh = trimesh.creation.box((0.02, 0.02, 0.02))
    vertices, faces = trimesh.remesh.subdivide(mesh.vertices, mesh.faces)
    moved = np.array(vertices)
    a, b, c = faces[0]
    moved[a] = 0.5 * (moved[b] + moved[c])
    with pytest.raises(UserError, match="triangles without area"):
        make(surface_positions=moved, surface_triangles=faces)


def test_held_nodes_are_listed_once():
    np.testing.assert_array_equal(make(fixed=[5, 3, 5, 3]).fixed, [3, 5])
