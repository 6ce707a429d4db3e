"""VTK, Gmsh and .trian as this package reads them: their kinds, damaged files, and what is refused."""

import base64
import zlib

import numpy as np
import pytest

from tissue_sim.errors import UserError
from tissue_sim.organ.meshes.mesh_input import read_mesh
from tissue_sim.organ.reporting.vtk_xml import polydata, tetrahedra
from tissue_sim.organ.surface_checks import check_surface, signed_volume

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
