"""Meshes: units, winding, holes, parts, and what is refused."""

import re

import numpy as np
import pytest
import trimesh

from tissue_sim.errors import UserError
from tissue_sim.organ.meshes.mesh_holes import capped_volume, fill, holes
from tissue_sim.organ.meshes.mesh_input import read_mesh, voxelize
from tissue_sim.organ.meshes.mesh_repair import once_used_edges
from tissue_sim.organ.normals import triangle_area
from tissue_sim.organ.surface_checks import check_surface, signed_volume


@pytest.fixture
def egg():
    mesh = trimesh.creation.icosphere(subdivisions=3, radius=20.0)
    mesh.apply_scale([1.0, 0.8, 1.6])
    return mesh


@pytest.mark.parametrize("suffix", ["obj", "stl", "ply", "off"])
def test_formats(tmp_path, egg, suffix):
    path = tmp_path / f"egg.{suffix}"
    egg.export(path)
    surface = read_mesh(path, "mm")
    assert surface.triangles.shape == (1280, 3)
    assert signed_volume(surface.positions, surface.triangles) == pytest.approx(egg.volume * 1e-9, rel=1e-4)


@pytest.mark.parametrize(("unit", "scale"), [("mm", 1e-3), ("cm", 1e-2), ("m", 1.0), ("um", 1e-6), ("in", 0.0254)])
def test_units(tmp_path, egg, unit, scale):
    egg.apply_scale(1e-3 / scale).export(tmp_path / "egg.ply")
    positions = read_mesh(tmp_path / "egg.ply", unit).positions
    np.testing.assert_allclose(np.ptp(positions, axis=0), [0.04, 0.032, 0.064], rtol=2e-3)


def test_the_longest_side_stands_in_for_a_unit(tmp_path, egg):
    egg.export(tmp_path / "egg.ply")
    surface = read_mesh(tmp_path / "egg.ply", longest=0.12)
    assert np.ptp(surface.positions, axis=0).max() == pytest.approx(0.12, rel=1e-9)
    assert surface.notes == ("scaled: the longest side is 12 cm",)
    for options, reason in (
        ({"longest": 0.12, "unit": "mm"}, "--unit and --length were given"),
        ({"longest": 12.0}, "--length 12 m is not a plausible longest side"),
        ({"unit": "ell"}, "unit ell is unknown; use one of mm, cm, m, um, in"),
        (
            {"unit": "m"},
            r"64 m long with --unit m, but an organ is 5 mm to 1 m; give --unit mm or cm, or its longest side",
        ),
        ({"unit": "um"}, r"give --unit mm or cm, or its longest side with --length METRES"),
    ):
        with pytest.raises(UserError, match=reason):
            read_mesh(tmp_path / "egg.ply", **options)


def test_points_keep_their_order(tmp_path, egg):
    shuffled = np.random.default_rng(4).permutation(len(egg.vertices))
    rank = np.argsort(shuffled)
    path = tmp_path / "egg.ply"
    trimesh.Trimesh(egg.vertices[shuffled], rank[egg.faces], process=False).export(path)
    surface = read_mesh(path, "mm")
    np.testing.assert_allclose(surface.positions * 1e3, egg.vertices[shuffled], rtol=1e-6)
    assert surface.repairs == ()


def test_gltf_is_in_metres(tmp_path, egg):
    path = tmp_path / "egg.glb"
    egg.apply_scale(1e-3).export(path)
    surface = read_mesh(path)  # y up, z to the front in the file: x to the left, y to the back, z up here
    expected = np.asarray(egg.vertices) @ np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]).T
    np.testing.assert_allclose(surface.positions, expected, atol=1e-6)
    assert signed_volume(surface.positions, surface.triangles) == pytest.approx(egg.volume, rel=1e-4)
    assert "rotated into the patient frame" in surface.notes[0]


def test_the_unit_must_be_known(tmp_path, egg):
    path = tmp_path / "egg.stl"
    egg.export(path)
    with pytest.raises(UserError, match=r"STL doesn't say its length unit; give --unit mm or --unit m"):
        read_mesh(path)


def without_cap(mesh, height):
    """The mesh without the triangles above a height: a hole as wide as the mesh is there."""
    keep = mesh.vertices[mesh.faces][:, :, 2].max(axis=1) < height
    return trimesh.Trimesh(mesh.vertices, mesh.faces[keep], process=False)


def test_small_holes_are_filled_and_reported(tmp_path, egg):
    open_egg = without_cap(egg, 31.8)  # the top of 32 mm
    keep = np.ones(len(open_egg.faces), dtype=bool)
    keep[[7, 400]] = False
    open_egg.update_faces(keep)
    open_egg.remove_unreferenced_vertices()
    open_egg.export(tmp_path / "open.ply")
    surface = read_mesh(tmp_path / "open.ply", "mm")
    check_surface(surface.positions, surface.triangles, "egg")
    np.testing.assert_allclose(surface.positions * 1e3, open_egg.vertices, atol=1e-5)
    assert len(surface.repairs) == 1
    found = re.fullmatch(r"filled 3 holes, up to ([\d.]+) mm wide", surface.repairs[0])
    rim = open_egg.vertices[np.unique(open_egg.edges_sorted[trimesh.grouping.group_rows(open_egg.edges_sorted, 1)])]
    top = rim[rim[:, 2] > 30.0]
    assert float(found[1]) == pytest.approx(np.linalg.norm(top[:, None] - top[None], axis=2).max(), rel=0.01)
    assert signed_volume(surface.positions, surface.triangles) == pytest.approx(egg.volume * 1e-9, rel=2e-3)


def test_a_wide_hole_is_refused_with_its_width(tmp_path, egg):
    without_cap(egg, 28.0).export(tmp_path / "open.obj")
    with pytest.raises(
        UserError, match=r"open\.obj is open: 1 hole, the widest (1[5-9]|2\d)\S* mm; holes up to a tenth"
    ) as caught:
        read_mesh(tmp_path / "open.obj", "mm")
    assert "\n" not in str(caught.value)


def test_a_hole_with_a_curved_rim_is_closed_without_folds():
    """A saddle-shaped rim of 24 points: a fan from one of them would fold."""
    angle = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
    radius = 1.0 + 0.6 * np.cos(3.0 * angle)  # a clover: not convex
    rim = np.stack([radius * np.cos(angle), radius * np.sin(angle), 0.05 * np.cos(2.0 * angle)], axis=1)
    wall = rim + [0.0, 0.0, -1.0]
    n = len(rim)
    k = np.arange(n)
    after = (k + 1) % n
    triangles = np.concatenate([np.stack([k + n, after + n, k], 1), np.stack([after + n, after, k], 1)])
    positions = np.concatenate([rim, wall])
    gaps = holes(positions, triangles)
    assert [len(gap.rim) for gap in gaps] == [n, n]
    filled = fill(positions, triangles, gaps)
    assert len(once_used_edges(filled)) == 0
    flat = 0.5 * abs(np.sum(rim[:, 0] * np.roll(rim[:, 1], -1) - rim[:, 1] * np.roll(rim[:, 0], -1)))
    patch = filled[len(triangles) :]
    assert triangle_area(positions, patch).sum() == pytest.approx(2.0 * flat, rel=0.02)  # folds would add area
    assert capped_volume(positions, filled, ()) == pytest.approx(flat, rel=0.02)


def test_coinciding_and_nearly_coinciding_points_are_merged(tmp_path, egg):
    soup = np.asarray(egg.vertices)[egg.faces].reshape(-1, 3)
    for name, noise, expected in (("soup", 0.0, "merged 3198 coinciding"), ("noisy", 0.02, "rim points across seams")):
        points = soup + np.random.default_rng(3).uniform(-noise, noise, soup.shape)
        trimesh.Trimesh(points, np.arange(len(soup)).reshape(-1, 3), process=False).export(tmp_path / f"{name}.ply")
        surface = read_mesh(tmp_path / f"{name}.ply", "mm")
        check_surface(surface.positions, surface.triangles, name)
        assert (len(surface.positions), len(surface.triangles)) == (642, 1280)
        assert expected in surface.repairs[0]
        assert signed_volume(surface.positions, surface.triangles) == pytest.approx(egg.volume * 1e-9, rel=5e-3)


def test_doubled_triangles_are_left_out(tmp_path, egg):
    doubled = np.concatenate([egg.faces, egg.faces[5:8], egg.faces[9:11, ::-1]])
    trimesh.Trimesh(egg.vertices, doubled, process=False).export(tmp_path / "doubled.ply")
    surface = read_mesh(tmp_path / "doubled.ply", "mm")
    assert surface.triangles.shape == (1280, 3)
    assert surface.repairs == ("omitted 5 duplicate triangles",)


def export(path, *meshes):
    trimesh.util.concatenate(meshes).export(path)
    return path


def test_parts_beside_and_inside(tmp_path, egg):
    def moved(scale, x):
        return egg.copy().apply_scale(scale).apply_translation([x, 0.0, 0.0])

    cavity = moved(0.4, 2.0)
    cavity.invert()
    islands = export(tmp_path / "islands.ply", moved(0.2, 60.0), egg, moved(0.1, 80.0), cavity)
    surface = read_mesh(islands, "mm")
    np.testing.assert_allclose(surface.positions * 1e3, egg.vertices, atol=1e-4)
    assert surface.repairs == (
        "omitted 2 separate parts of 0.383 mL next to 42.5 mL",
        "filled 1 cavity of 2.72 mL",
    )
    twins = export(tmp_path / "twins.ply", egg, moved(0.7, 60.0))
    with pytest.raises(UserError, match=r"2 separate parts: 1 42\.5 mL, 2 14\.6 mL; choose one with --part N, or join"):
        read_mesh(twins, "mm")
    second = read_mesh(twins, "mm", part=2)
    assert signed_volume(second.positions, second.triangles) == pytest.approx(0.343 * egg.volume * 1e-9, rel=1e-3)
    for part, reason in ((3, "has no part 3; it contains 1 42.5 mL"), ("left", "has no part 'left'")):
        with pytest.raises(UserError, match=reason):
            read_mesh(twins, "mm", part=part)


def test_parts_have_the_names_of_the_file(tmp_path, egg):
    scene = trimesh.Scene()
    scene.add_geometry(egg.copy().apply_scale(1e-3), node_name="liver", geom_name="a")
    scene.add_geometry(egg.copy().apply_scale(8e-4).apply_translation([0.1, 0, 0]), node_name="spleen", geom_name="b")
    scene.export(tmp_path / "two.glb")
    with pytest.raises(UserError, match=r"1 liver 42\.5 mL, 2 spleen 21\.8 mL"):
        read_mesh(tmp_path / "two.glb")
    assert read_mesh(tmp_path / "two.glb", part="spleen").positions[:, 0].min() > 0.05


@pytest.mark.extended
def test_overlapping_parts_are_joined(tmp_path, egg):
    ball = trimesh.creation.icosphere(subdivisions=3, radius=16.0).apply_translation([24.0, 0.0, 0.0])
    both = export(tmp_path / "both.ply", egg, ball)
    surface = read_mesh(both, "mm", merge_parts=True)
    check_surface(surface.positions, surface.triangles, "both")
    probe = np.random.default_rng(5).uniform([-25, -20, -35], [45, 20, 35], (200_000, 3))
    inside = (((probe / [20.0, 16.0, 32.0]) ** 2).sum(axis=1) < 1) | (((probe - [24, 0, 0]) ** 2).sum(axis=1) < 256)
    expected = inside.mean() * 70 * 40 * 70 * 1e-9
    assert signed_volume(surface.positions, surface.triangles) == pytest.approx(expected, rel=0.02)
    assert surface.repairs[0].startswith("joined 2 parts on a grid of 0.5 mm")
    with pytest.raises(UserError, match="--part and --merge-parts"):
        read_mesh(both, "mm", part=1, merge_parts=True)


@pytest.mark.extended
def test_parts_are_joined_across_a_gap_or_told_to_be_too_far_apart(tmp_path):
    box = trimesh.creation.box([40.0, 40.0, 40.0])
    near = export(tmp_path / "near.ply", box, box.copy().apply_translation([42.0, 0.0, 0.0]))
    surface = read_mesh(near, "mm", merge_parts=True)
    check_surface(surface.positions, surface.triangles, "near")
    assert signed_volume(surface.positions, surface.triangles) == pytest.approx(82.0 * 40.0 * 40.0 * 1e-9, rel=0.02)
    assert surface.repairs[1].startswith("joined 2 separate parts across gaps of up to 2.5")
    far = export(tmp_path / "far.ply", box, box.copy().apply_translation([100.0, 0.0, 0.0]))
    with pytest.raises(UserError, match=r"far\.ply has parts 61.* mm apart, too far for one organ; build each with"):
        read_mesh(far, "mm", merge_parts=True)


def test_parts_that_share_a_wall_are_refused_with_the_remedy(tmp_path):
    """Where they meet, each edge has three triangles: no part is a closed surface."""
    box = trimesh.creation.box([40.0, 40.0, 40.0])
    both = export(tmp_path / "both.stl", box, box.copy().apply_translation([40.0, 0.0, 0.0]))
    with pytest.raises(UserError, match=r"its part 1 has \d+ edges with more than two triangles; separate its solids"):
        read_mesh(both, "mm", merge_parts=True)


def test_a_ring_keeps_its_handle_and_says_so(tmp_path):
    ring = trimesh.creation.torus(major_radius=30.0, minor_radius=10.0)
    ring.export(tmp_path / "ring.ply")
    surface = read_mesh(tmp_path / "ring.ply", "mm")
    assert surface.genus == 1
    assert "1 handle (genus 1)" in surface.notes[0]


def test_inward_and_mixed_winding_are_repaired_and_reported(tmp_path, egg):
    inward = tmp_path / "inward.ply"
    trimesh.Trimesh(egg.vertices, egg.faces[:, ::-1], process=False).export(inward)
    surface = read_mesh(inward, "mm")
    assert surface.repairs == ("flipped inward triangles",)
    assert signed_volume(surface.positions, surface.triangles) > 0
    mixed = tmp_path / "mixed.ply"
    faces = egg.faces.copy()
    faces[::3] = faces[::3, ::-1]
    trimesh.Trimesh(egg.vertices, faces, process=False).export(mixed)
    surface = read_mesh(mixed, "mm")
    assert "made the winding consistent" in surface.repairs
    assert signed_volume(surface.positions, surface.triangles) == pytest.approx(egg.volume * 1e-9, rel=1e-6)


def test_other_refusals(tmp_path, egg):
    two = tmp_path / "two.ply"
    trimesh.util.concatenate([egg, egg.copy().apply_translation([100.0, 0.0, 0.0])]).export(two)
    garbage = tmp_path / "garbage.ply"
    garbage.write_bytes(b"ply\nnot really")
    unknown = tmp_path / "mesh.step"
    unknown.write_text("x")
    empty = tmp_path / "empty.obj"
    empty.write_text("v 0 0 0\n")
    fan = tmp_path / "fan.off"
    fan.write_text("OFF\n5 3 0\n0 0 0\n0 0 1\n1 0 0\n0 1 0\n-1 0 0\n3 0 1 2\n3 0 1 3\n3 0 1 4\n")
    for path, reason in {
        two: "2 separate parts",
        garbage: "can't be read",
        unknown: "no known mesh format",
        empty: "no triangles|can't be read",
        fan: "1 edges with more than two triangles",
        tmp_path / "none.stl": "does not exist",
    }.items():
        with pytest.raises(UserError, match=reason) as caught:
            read_mesh(path, "mm")
        assert path.name in str(caught.value)
        assert "\n" not in str(caught.value)


def test_voxels_have_the_solids_volume(tmp_path, egg):
    path = tmp_path / "egg.ply"
    egg.export(path)
    mask = voxelize(read_mesh(path, "mm"), "egg")
    assert mask.array.sum() * mask.voxel_volume == pytest.approx(egg.volume * 1e-3, rel=0.01)
    inside = mask.to_points(np.argwhere(mask.array)[:, ::-1])
    np.testing.assert_allclose(inside.mean(axis=0), 0.0, atol=0.3)


def test_hollow_and_thin_shells_are_refused(tmp_path, egg):
    inner = egg.copy().apply_scale(0.95)
    inner.invert()
    shell = export(tmp_path / "shell.ply", egg, inner)
    with pytest.raises(UserError, match=r"hollow shell: the cavity is 86 % .* give --part 1 to fill it"):
        read_mesh(shell, "mm")
    filled = read_mesh(shell, "mm", part=1)
    assert signed_volume(filled.positions, filled.triangles) == pytest.approx(egg.volume * 1e-9, rel=1e-4)
    cup = trimesh.creation.revolve(  # one closed surface: a wall of 2 mm around a bowl that opens upward
        [[0, -30], [20, -30], [30, 0], [30, 20], [28, 20], [28, 0], [18.5, -28], [0, -28]], sections=48
    )
    sheet = trimesh.creation.box([60.0, 60.0, 0.3])
    for mesh, reason in (
        (cup, r"thin shell: its walls have a mean thickness of [12]\.\d mm"),
        (sheet, "too thin|thin shell"),
    ):
        mesh.export(tmp_path / "thin.stl")
        with pytest.raises(UserError, match=reason):
            voxelize(read_mesh(tmp_path / "thin.stl", "mm"), "thin")
    rod = trimesh.creation.capsule(height=200.0, radius=6.0)  # slender, but solid
    rod.export(tmp_path / "rod.ply")
    voxelize(read_mesh(tmp_path / "rod.ply", "mm"), "rod")
