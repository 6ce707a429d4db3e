"""Meshes: units, winding, holes, parts, and what is refused."""

import base64
import re
import zlib

import numpy as np
import pytest
import trimesh

from tissue_sim.errors import UserError
from tissue_sim.organ.meshes.mesh_holes import capped_volume, fill, holes
from tissue_sim.organ.meshes.mesh_input import read_mesh, voxelize
from tissue_sim.organ.meshes.mesh_repair import once_used_edges
from tissue_sim.organ.normals import triangle_area
from tissue_sim.organ.reporting.vtk_xml import polydata, tetrahedra
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


# formats of our own ---------------------------------------------------------------------------

TETRA = np.array([[0.0, 0.0, 0.0], [40.0, 0.0, 0.0], [0.0, 40.0, 0.0], [0.0, 0.0, 40.0]])
FACES = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])


def vtk(version, kind, sections, title="a title"):
    return f"# vtk DataFile Version {version}\n{title}\n{kind}\nDATASET POLYDATA\n".encode() + b"".join(sections)


def text(array):
    return " ".join(f"{value:g}" for value in np.asarray(array).ravel()).encode() + b"\n"


def big(array, kind):
    return np.asarray(array).astype(">" + kind).tobytes() + b"\n"


def little(array, kind):
    return np.asarray(array).astype("<" + kind).tobytes()


def vtk_xml(kind, arrays, appended=b"", **given):
    """VTK's XML of one piece: arrays by section, name and attributes, with their text."""
    said = "".join(f' {name}="{value}"' for name, value in given.items())
    found = f'<?xml version="1.0"?>\n<VTKFile type="{kind}" version="1.0"{said}><{kind}><Piece>'
    for section, each in arrays.items():
        inside = "".join(
            f'<DataArray type="{number}" Name="{name}" {how}>{words}</DataArray>' for name, number, how, words in each
        )
        found += f"<{section}>{inside}</{section}>"
    found += f"</Piece></{kind}>"
    if appended:
        return f'{found}<AppendedData encoding="raw">\n _'.encode() + appended + b"</AppendedData></VTKFile>"
    return f"{found}</VTKFile>".encode()


def words(array):
    return " ".join(f"{value:g}" for value in np.asarray(array).ravel())


def blocks(array, kind, size=20):
    """Big-endian numbers as blocks that are compressed by zlib, in base64, behind a header with a code of its own."""
    whole = np.asarray(array).astype(">" + kind).tobytes()
    parts = [zlib.compress(whole[at : at + size]) for at in range(0, len(whole), size)]
    head = np.array([len(parts), size, len(whole) % size, *map(len, parts)], dtype=">u8")
    return (base64.b64encode(head.tobytes()) + base64.b64encode(b"".join(parts))).decode()


def raw(*arrays):
    """Each behind its length, and where each begins."""
    each = [len(one).to_bytes(4, "little") + one for one in arrays]
    starts = np.cumsum([0, *map(len, each)])
    return b"".join(each), [f'format="appended" offset="{start}"' for start in starts]


RAW, AT = raw(little(TETRA, "f4"), little(FACES, "i8"), little([3, 6, 9, 12], "i8"))
ASCII, BINARY = 'format="ascii"', 'format="binary"'
CELLS = np.insert(FACES, 0, 3, axis=1)
STRIP = [6, 2, 0, 1, 3, 2, 0]  # the whole tetrahedron in one strip: its odd triangles are turned
LONG = b"liver " * 20  # longer than 63 bytes: its length takes two
OWN_FORMATS = {
    "old.vtk": vtk("3.0", "ASCII", [b"POINTS 4 float\n", text(TETRA), b"POLYGONS 4 16\n", text(CELLS)]),
    "binary.vtk": vtk(
        "4.2",
        "BINARY",
        [b"POINTS 4 double\n", big(TETRA, "f8"), b"METADATA\nINFORMATION 0\n\n", b"POLYGONS 4 16\n", big(CELLS, "i4")],
    ),
    "new.vtk": vtk(
        "5.1",
        "BINARY",
        [
            *(b"POINTS 4 float\n", big(TETRA, "f4"), b"POLYGONS 5 12\n"),
            *(b"OFFSETS vtktypeint64\n", big([0, 3, 6, 9, 12], "i8")),
            *(b"CONNECTIVITY vtktypeint64\n", big(FACES, "i8"), b"POINT_DATA 4\n"),
        ],
    ),
    "strip.vtk": vtk("4.2", "ASCII", [b"POINTS 4 float\n", text(TETRA), b"TRIANGLE_STRIPS 1 7\n", text(STRIP)]),
    "both.vtk": vtk(
        "4.2",
        "BINARY",
        [
            *(b"POINTS 4 float\n", big(TETRA, "f4"), b"POLYGONS 2 8\n", big(CELLS[:2], "i4")),
            *(b"TRIANGLE_STRIPS 1 5\n", big([4, 1, 2, 3, 0], "i4")),
        ],
    ),
    "named.vtk": vtk(
        "5.1",
        "ASCII",
        [
            b"FIELD FieldData 4\nName 1 2 string\nliver%20left\nPOINTS 9 float\nMETADATA\nINFORMATION 0\n\n",
            b"flags 1 3 bit\n1 0 1\nany 1 1 variant\n13 a%20b\ntime 1 1 double\n0.5\n",
            *(b"POINTS 4 float\n", text(TETRA), b"POLYGONS 4 16\n", text(CELLS)),
        ],
    ),
    "named_binary.vtk": vtk(
        "4.2",
        "BINARY",
        [
            b"FIELD FieldData 3\nName 1 2 string\n",
            *(bytes([0xC0 | 5]), b"liver", (0x8000 | len(LONG)).to_bytes(2, "big"), LONG, b"\n"),
            *(b"flags 1 9 bit\n", b"\xff\x80", b"\ntime 1 1 double\n", big([0.5], "f8")),
            *(b"POINTS 4 double\n", big(TETRA, "f8"), b"POLYGONS 4 16\n", big(CELLS, "i4")),
        ],
    ),
    "ascii.vtp": vtk_xml(
        "PolyData",
        {
            "Points": [("p", "Float32", ASCII, words(TETRA))],
            "Polys": [("connectivity", "Int64", ASCII, words(FACES)), ("offsets", "Int32", ASCII, "3 6 9 12")],
        },
    ),
    "strip.vtp": vtk_xml(
        "PolyData",
        {
            "Points": [("p", "Float64", ASCII, words(TETRA))],
            "Strips": [("connectivity", "Int64", ASCII, words(STRIP[1:])), ("offsets", "Int64", ASCII, "6")],
        },
    ),
    "packed.vtp": vtk_xml(
        "PolyData",
        {
            "Points": [("p", "Float64", BINARY, blocks(TETRA, "f8"))],
            "Polys": [
                ("connectivity", "UInt32", BINARY, blocks(FACES, "u4")),
                ("offsets", "UInt32", BINARY, blocks([3, 6, 9, 12], "u4")),
            ],
        },
        byte_order="BigEndian",
        header_type="UInt64",
        compressor="vtkZLibDataCompressor",
    ),
    "appended.vtp": vtk_xml(
        "PolyData",
        {
            "Points": [("p", "Float32", AT[0], "")],
            "Polys": [("connectivity", "Int64", AT[1], ""), ("offsets", "Int64", AT[2], "")],
        },
        RAW,
        byte_order="LittleEndian",
        header_type="UInt32",
    ),
    "exported.vtp": polydata(TETRA, {}, polygons=FACES.astype(np.int32)),
    "exported.vtu": tetrahedra(TETRA, np.array([[0, 1, 2, 3]], dtype=np.int32), {}, {}),
    "two_binary.msh": b"$MeshFormat\n2.2 1 8\n"
    + little([1], "i4")
    + b"\n$EndMeshFormat\n$Nodes\n4\n"
    + b"".join(little([k + 1], "i4") + little(point, "f8") for k, point in enumerate(TETRA))
    + b"\n$EndNodes\n$Elements\n4\n"
    + little([2, 4, 2], "i4")
    + b"".join(little([k + 1, 0, 1, *(face + 1)], "i4") for k, face in enumerate(FACES))
    + b"\n$EndElements\n",
    "four_binary.msh": b"$MeshFormat\n4.1 1 8\n"
    + little([1], "i4")
    + b"\n$EndMeshFormat\n$Nodes\n"
    + little([1, 4, 1, 4], "u8")
    + little([3, 1, 0], "i4")
    + little([4, 1, 2, 3, 4], "u8")
    + little(TETRA, "f8")
    + b"\n$EndNodes\n$Elements\n"
    + little([1, 1, 1, 1], "u8")
    + little([3, 1, 4], "i4")
    + little([1, 1, 1, 2, 3, 4], "u8")
    + b"\n$EndElements\n",
    "plain.trian": b"4\n" + text(TETRA) + b"4\n" + text(FACES),
    "neighbours.trian": b"4\n" + text(TETRA) + b"4\n" + text(np.hstack([FACES, FACES])),
    "one.msh": b"$NOD\n4\n"
    + b"".join(text([k + 1, *point]) for k, point in enumerate(TETRA))
    + b"$ENDNOD\n$ELM\n1\n1 4 1 1 4 1 3 2 4\n$ENDELM\n",
    "two.msh": b"$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n4\n"
    + b"".join(text([10 * k + 5, *point]) for k, point in enumerate(TETRA))
    + b"$EndNodes\n$Elements\n5\n1 15 2 0 1 5\n"
    + b"".join(text([k + 2, 2, 2, 0, 1, *(10 * face + 5)]) for k, face in enumerate(FACES))
    + b"$EndElements\n",
    "four.msh": b"$MeshFormat\n4.1 0 8\n$EndMeshFormat\n$Nodes\n2 4 1 4\n2 1 0 3\n1\n2\n3\n"
    + b"".join(text(point) for point in TETRA[:3])
    + b"3 1 0 1\n4\n"
    + text(TETRA[3])
    + b"$EndNodes\n$Elements\n1 1 1 1\n3 1 4 1\n1 1 2 3 4\n$EndElements\n",
}


@pytest.mark.parametrize("name", OWN_FORMATS)
def test_vtk_gmsh_and_trian(tmp_path, name):
    (tmp_path / name).write_bytes(OWN_FORMATS[name])
    surface = read_mesh(tmp_path / name, "mm")
    check_surface(surface.positions, surface.triangles, name)
    np.testing.assert_allclose(surface.positions * 1e3, TETRA)
    assert signed_volume(surface.positions, surface.triangles) == pytest.approx(40.0**3 / 6.0 * 1e-9)


@pytest.mark.parametrize("name", OWN_FORMATS)
def test_their_damaged_files_take_one_line(tmp_path, name):
    whole = OWN_FORMATS[name]
    damaged = [whole[: len(whole) * k // 8] for k in range(8)]
    if name.endswith((".vtp", ".vtu")):
        wrong = (b'Name="offsets"', b'Name="elsewhere"')
    elif b"BINARY" in whole:
        wrong = (b"\0\0\0\3", b"\0\0\0\x09")
    else:
        wrong = (b"3", b"9") if b"vtk" in whole else (b"4", b"9")
    damaged.append(whole.replace(*wrong))
    for content in damaged:
        (tmp_path / name).write_bytes(content)
        with pytest.raises(UserError) as caught:
            read_mesh(tmp_path / name, "mm")
        assert name in str(caught.value)
        assert "\n" not in str(caught.value)


SPACE = b'<PolyData><FieldData><Array type="String" Name="SPACE" format="ascii">82 65 83 0</Array></FieldData>'
IN_RAS = {
    "ras.vtk": vtk(
        "3.0",
        "ASCII",
        [b"POINTS 4 float\n", text(TETRA), b"POLYGONS 4 16\n", text(CELLS)],
        "3D Slicer output. SPACE=RAS",
    ),
    "ras.vtp": OWN_FORMATS["ascii.vtp"].replace(b"<PolyData>", SPACE),
}


@pytest.mark.parametrize("name", IN_RAS)
def test_a_vtk_of_slicer_in_ras_is_turned(tmp_path, name):
    (tmp_path / name).write_bytes(IN_RAS[name])
    surface = read_mesh(tmp_path / name, "mm")
    np.testing.assert_allclose(surface.positions * 1e3, TETRA * [-1.0, -1.0, 1.0])
    assert surface.notes == ("converted from RAS to LPS",)


def curved():
    """A tetrahedron of second order: its corners, and points beside the middles of its edges, as meshio orders them."""
    pairs = [(0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3)]
    bent = [0.5 * (TETRA[a] + TETRA[b]) + [1.0, 1.0, 1.0] for a, b in pairs]
    return np.vstack([TETRA, bent]), pairs


@pytest.mark.parametrize(
    ("suffix", "file_format"), [("msh", "gmsh22"), ("msh", "gmsh"), ("vtu", "vtu"), ("vtk", "vtk")]
)
def test_of_elements_of_second_order_the_corners_are_taken_and_reported(tmp_path, suffix, file_format):
    import meshio

    points, pairs = curved()
    middle = {frozenset(pair): 4 + k for k, pair in enumerate(pairs)}
    sides = [[*face, *(middle[frozenset((face[k], face[(k + 1) % 3]))] for k in range(3))] for face in FACES.tolist()]
    curved_sides = "took the corners of elements of second or higher order: curved sides are flat"
    for cells, notes in (
        ({"tetra10": [list(range(10))]}, (curved_sides, "used the surface of 1 tetrahedra")),
        ({"triangle6": sides}, (curved_sides,)),
    ):
        file = tmp_path / f"curved.{suffix}"
        meshio.write(file, meshio.Mesh(points, cells), file_format=file_format)
        surface = read_mesh(file, "mm")
        np.testing.assert_allclose(surface.positions * 1e3, TETRA)
        assert signed_volume(surface.positions, surface.triangles) == pytest.approx(40.0**3 / 6.0 * 1e-9)
        assert (surface.repairs, surface.notes) == ((), notes)


@pytest.mark.parametrize("suffix", ["msh", "vtu", "vtk"])
def test_solids_that_are_no_tetrahedra_are_refused_and_not_passed_over(tmp_path, suffix):
    import meshio

    cube = np.array([[x, y, z] for z in (0.0, 30.0) for x, y in ((0.0, 0.0), (30.0, 0.0), (30.0, 30.0), (0.0, 30.0))])
    points, tetra = np.vstack([cube, TETRA + 100.0]), [[8, 9, 10, 11]]
    file = tmp_path / f"mixed.{suffix}"
    mixed = meshio.Mesh(points, {"hexahedron": [list(range(8))], "tetra": tetra})
    meshio.write(file, mixed, file_format="gmsh22" if suffix == "msh" else suffix)
    with pytest.raises(UserError, match="cells of the kind hexahedron: split them into tetrahedra first"):
        read_mesh(file, "mm")


@pytest.mark.parametrize(
    ("old", "new", "line"),
    [
        (b"<VTKFile", b"<!DOCTYPE x [<!ENTITY a 'a'>]><VTKFile", "a document type"),
        (b"vtkZLibDataCompressor", b"vtkLZ4DataCompressor", "compressed by vtkLZ4DataCompressor: save it with zlib"),
        (b'type="PolyData"', b'type="ImageData"', "a VTK ImageData, no surface"),
        (b"Float64", b"Float16", "numbers of the type Float16"),
    ],
)
def test_what_no_xml_of_vtk_is_to_hold_is_refused(tmp_path, old, new, line):
    (tmp_path / "wrong.vtp").write_bytes(OWN_FORMATS["packed.vtp"].replace(old, new))
    with pytest.raises(UserError, match=line):
        read_mesh(tmp_path / "wrong.vtp", "mm")


def test_a_block_that_claims_more_than_its_bytes_can_hold_is_refused(tmp_path):
    head = np.array([1, 2**40, 2**40, 8], dtype=">u8").tobytes()
    bomb = (base64.b64encode(head) + base64.b64encode(b"12345678")).decode()
    whole = OWN_FORMATS["packed.vtp"].replace(blocks(TETRA, "f8").encode(), bomb.encode())
    (tmp_path / "bomb.vtp").write_bytes(whole)
    with pytest.raises(UserError, match="larger than its bytes can make it"):
        read_mesh(tmp_path / "bomb.vtp", "mm")
