"""Mesh files whose numbers are none: refused with one line, and nothing else is printed."""

import struct
import subprocess
import sys

import numpy as np
import pytest
import trimesh

from tissue_sim.errors import UserError
from tissue_sim.organ.meshes.mesh_input import read_mesh

POINTS, TRIANGLES = trimesh.creation.box(extents=(40.0, 30.0, 20.0)).vertices, trimesh.creation.box().faces


def rows(array, start=""):
    return "".join(start + " ".join(f"{value:g}" for value in row) + "\n" for row in array)


def vtk_5(offsets) -> str:
    n, t = len(POINTS), len(TRIANGLES)
    return (
        f"# vtk DataFile Version 5.1\nbox\nASCII\nDATASET POLYDATA\nPOINTS {n} double\n{rows(POINTS)}"
        f"POLYGONS {t + 1} {3 * t}\nOFFSETS vtktypeint64\n{' '.join(map(str, offsets))}\n"
        f"CONNECTIVITY vtktypeint64\n{rows(TRIANGLES)}"
    )


def vtk_3(kind="float", points=POINTS, count=None) -> str:
    t = len(TRIANGLES)
    return (
        f"# vtk DataFile Version 3.0\nbox\nASCII\nDATASET POLYDATA\nPOINTS {len(points)} {kind}\n{rows(points)}"
        f"POLYGONS {count or t} {4 * t}\n{rows(TRIANGLES, '3 ')}"
    )


def gmsh(first="1") -> str:
    nodes = [f"{k} {x:g} {y:g} {z:g}" for k, (x, y, z) in enumerate(POINTS, 1)]
    nodes[0] = nodes[0].replace("1 ", f"{first} ", 1)
    elements = [f"{k} 2 2 1 1 {a + 1} {b + 1} {c + 1}" for k, (a, b, c) in enumerate(TRIANGLES, 1)]
    return (
        f"$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n{len(nodes)}\n" + "\n".join(nodes) + "\n$EndNodes\n"
        f"$Elements\n{len(elements)}\n" + "\n".join(elements) + "\n$EndElements\n"
    )


OFFSETS = [3 * k for k in range(len(TRIANGLES) + 1)]
FAR = np.where(np.arange(len(POINTS))[:, None] == 0, 1e300, POINTS)


@pytest.mark.parametrize(
    ("suffix", "text", "reason"),
    [
        ("vtk", vtk_5([*OFFSETS[:3], "inf", *OFFSETS[4:]]), "an invalid number"),
        ("vtk", vtk_5([*OFFSETS[:3], "nan", *OFFSETS[4:]]), "an invalid number"),
        ("vtk", vtk_5([*OFFSETS[:3], "9223372036854775808", *OFFSETS[4:]]), "an invalid number"),
        ("vtk", vtk_3("int", FAR), "an invalid number"),
        ("vtk", vtk_3("float", FAR), "not finite, or beyond"),
        ("vtk", vtk_3("double", FAR), "not finite, or beyond"),
        ("vtk", vtk_3(count=1_000_000_000), "more polygons than numbers"),
        ("vtk", vtk_3().replace("\n3 1 ", "\n3 8 ", 1), "a triangle names a point that doesn't exist"),
        ("vtk", vtk_3().replace("\n3 1 ", "\n3 -1 ", 1), "a triangle names a point that doesn't exist"),
        ("trian", f"8\n{rows(POINTS)}1\n0 1 8\n", "a triangle names a point that doesn't exist"),
        ("msh", gmsh("inf"), "can't be read as a mesh"),
        ("obj", "v 1 2\n" * 4 + "f 1 2 3\nf 1 3 4\nf 1 4 2\nf 2 4 3\n", "can't be read|three coordinates"),
        ("off", f"OFF\n{len(FAR)} {len(TRIANGLES)} 0\n{rows(FAR)}{rows(TRIANGLES, '3 ')}", "not finite, or beyond"),
        (
            "off",
            f"OFF\n8 {len(TRIANGLES)} 0\n{rows(0 * POINTS)}{rows(TRIANGLES, '3 ')}",
            "with an area|encloses no volume",
        ),
    ],
)
@pytest.mark.parametrize("measure", [{"unit": "mm"}, {"longest": 0.1}])
def test_numbers_that_are_none_are_refused(tmp_path, recwarn, capfd, suffix, text, reason, measure):
    (tmp_path / f"box.{suffix}").write_text(text)
    with pytest.raises(UserError, match=reason) as caught:
        read_mesh(tmp_path / f"box.{suffix}", **measure)
    assert "\n" not in str(caught.value)
    assert not [warning for warning in recwarn.list if issubclass(warning.category, RuntimeWarning)]
    assert capfd.readouterr() == ("", "")


def test_the_same_files_whole_are_read(tmp_path):
    for name, text in (("a.vtk", vtk_5(OFFSETS)), ("b.vtk", vtk_3("int")), ("c.vtk", vtk_3()), ("d.msh", gmsh())):
        (tmp_path / name).write_text(text)
        found = read_mesh(tmp_path / name, unit="mm")
        np.testing.assert_allclose(np.ptp(found.positions, axis=0), [0.04, 0.03, 0.02])


@pytest.mark.extended
def test_what_a_library_puts_up_with_is_not_printed(tmp_path):
    """A normal of an STL that is no number: its triangle defines it as well. In a process whose logging nobody took."""
    text = trimesh.Trimesh(POINTS, TRIANGLES, process=False).export(file_type="stl_ascii")
    (tmp_path / "box.stl").write_text(text.replace("facet normal ", "facet normal x", 1))
    code = (
        "from tissue_sim.organ.meshes.mesh_input import read_mesh\n"
        f"print(len(read_mesh({str(tmp_path / 'box.stl')!r}, unit='mm').triangles))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.stdout, done.stderr) == (f"{len(TRIANGLES)}\n", "")


def test_a_glb_chunk_of_gigabytes_asks_for_no_room(tmp_path):
    data = trimesh.Trimesh(POINTS * 1e-3, TRIANGLES, process=False).export(file_type="glb")
    (tmp_path / "box.glb").write_bytes(data)
    assert len(read_mesh(tmp_path / "box.glb").triangles) == len(TRIANGLES)
    longer = data + struct.pack("<II", 2**32 - 4, 0x004E4942) + bytes(16)
    (tmp_path / "box.glb").write_bytes(longer)
    with pytest.raises(UserError, match="cut off, damaged or not GLB"):
        read_mesh(tmp_path / "box.glb")
