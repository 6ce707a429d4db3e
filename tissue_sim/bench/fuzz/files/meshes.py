"""Hostile meshes of every format: wrong counts, invalid numbers, parts cut off, names of other files."""

from __future__ import annotations

import base64
import json
import struct
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

from tissue_sim.array_types import Floats, Longs
from tissue_sim.bench.fuzz.cases import Broken, Case, Input
from tissue_sim.bench.fuzz.files.mutations import HUGE, Rng, odd_count, odd_float, of_bytes, of_text, some
from tissue_sim.bench.fuzz.files.zips import OUTSIDE
from tissue_sim.organ.meshes.mesh_input import SurfaceMesh, read_mesh, voxelize
from tissue_sim.organ.organ import check_surface
from tissue_sim.organ.reporting.vtk_xml import tetrahedra

LENGTH = 0.1  # m, stated longest side of an organ
_AXIS = 24  # voxels along the longest side: as a mesh is used, in less time


def prepare(case: Case, folder: Path) -> Input:
    """Make a mesh file with one or more mutations."""
    rng = case.rng()
    form: Form = some(rng, _FORMS)
    data, what = mutated(rng, form)
    path = folder / f"mesh{form.suffix}"
    path.write_bytes(data)
    unit = rng.random() < 0.3
    merge = rng.random() < 0.15
    return Input(f"{form.name}: {what}", lambda: use(path, unit=unit, merge_parts=merge))


def warm_up(folder: Path) -> None:
    """Read one of each format."""
    for form in _FORMS:
        path = folder / f"mesh{form.suffix}"
        path.write_bytes(form.made())
        use(path)


def use(path: Path, *, unit: bool = False, merge_parts: bool = False) -> str:
    """Read and repair a surface, make voxels of it, and check that it is closed and finite."""
    measure = {"unit": "mm"} if unit else {"longest": LENGTH}
    mesh = read_mesh(path, **measure, merge_parts=merge_parts)  # type: ignore[arg-type]
    _check(mesh)
    solid = voxelize(mesh, str(path), _AXIS)
    return f"{len(mesh.positions)} points, {np.count_nonzero(solid.array)} voxels"


def _check(mesh: SurfaceMesh) -> None:
    if not np.all(np.isfinite(mesh.positions)):
        raise Broken("points that are not finite")
    used, inverse = np.unique(mesh.triangles, return_inverse=True)
    check_surface(mesh.positions[used], inverse.reshape(-1, 3).astype(np.int32), "the surface that was read")


_Told = tuple[bytes, str]


class Form:
    """Format with an intact file and a mutation of its own kind."""

    def __init__(self, name: str, suffix: str, write: Callable[[], bytes], lie: Callable[[Rng, bytes], _Told]) -> None:
        self.name, self.suffix, self._write, self._lie = name, suffix, write, lie

    def made(self) -> bytes:
        """Return an intact file."""
        return self._write()

    def lying(self, rng: Rng) -> tuple[bytes, str]:
        """Return a file whose head contradicts its content."""
        return self._lie(rng, self._write())


def mutated(rng: Rng, form: Form) -> tuple[bytes, str]:
    """Return the bytes of a mesh file with a mutation, and its description."""
    draw = rng.random()
    if draw < 0.45:
        return form.lying(rng)
    if draw < 0.55 and form.suffix != ".glb":
        return _in_disguise(rng, form)
    return of_bytes(rng, form.made())


def _in_disguise(rng: Rng, form: Form) -> tuple[bytes, str]:
    other: Form = some(rng, _FORMS)
    return other.made(), f"a file of {other.name}"


# a body to write ----------------------------------------------------------------------------------


@lru_cache(maxsize=1)
def _ball() -> tuple[Floats, Longs]:
    mesh = trimesh.creation.icosphere(2)
    return np.round(np.asarray(mesh.vertices) * [50.0, 30.0, 25.0], 4), np.asarray(mesh.faces, dtype=np.int64)


def _rows(array: NDArray, start: str = "", shift: int = 0) -> str:
    return "\n".join(start + " ".join(f"{value + shift:g}" for value in row) for row in array) + "\n"


def _text(rng: Rng, data: bytes) -> _Told:
    return of_text(rng, data)


# STL, PLY, OFF, OBJ -------------------------------------------------------------------------------


def _exported(kind: str, **options: Any) -> Callable[[], bytes]:
    @lru_cache(maxsize=1)
    def write() -> bytes:
        data = trimesh.Trimesh(*_ball(), process=False).export(file_type=kind, **options)
        return data.encode() if isinstance(data, str) else bytes(data)

    return write


def _stl(rng: Rng, data: bytes) -> _Told:
    made = bytearray(data)
    if rng.random() < 0.5:
        count = odd_count(rng, struct.unpack_from("<I", data, 80)[0]) % 2**32
        struct.pack_into("<I", made, 80, count)
        return bytes(made), f"{count} triangles"
    value = odd_float(rng)
    with np.errstate(all="ignore"):
        for _ in range(int(rng.integers(1, 5))):
            at = 84 + 50 * int(rng.integers((len(made) - 84) // 50)) + 4 * int(rng.integers(12))
            made[at : at + 4] = np.float32(value).tobytes()
    return bytes(made), f"{value:g} in it"


def _ply(rng: Rng, data: bytes) -> _Told:
    end = data.index(b"end_header")
    head, rest = data[:end], data[end:]
    if rng.random() < 0.6:
        made, told = of_text(rng, head)
        return made + rest, told
    count = str(some(rng, HUGE)).encode()
    old, new = some(
        rng,
        (
            (b"vertex 162", b"vertex " + count),
            (b"face 320", b"face " + count),
            (b"uchar int", some(rng, (b"float float", b"int double", b"char uchar", b"double int"))),
            (b"float x", some(rng, (b"uchar x", b"list uchar float x", b"string x", b"double x"))),
            (b"little_endian", b"big_endian"),
            (b"element face", b"comment"),
        ),
    )
    return head.replace(old, new, 1) + rest, f"'{new.decode()}' in its head"


def _obj(rng: Rng, data: bytes) -> _Told:
    if rng.random() < 0.6:
        return of_text(rng, data)
    odd = (
        f"mtllib {OUTSIDE}",
        "mtllib /etc/passwd\nusemtl x",
        f"mtllib {OUTSIDE}\nusemtl a\nf 1 2 3",
        "call ../outside",
        "f 0 0 0",
        "f -1 -2 -3",
        "f 1 2 99999999999999999999",
        "f 1//1 2//2 3//3",
        "f 1/2/3/4 2 3",
        "f 1 2",
        "f " + " ".join(["1"] * 20_000),
        "v 1 2",
        "v nan nan nan",
        "o " + "x" * 10_000,
        "g a\ng b\nf 1 2 3",
    )
    line = some(rng, odd)
    lines = data.split(b"\n")
    lines.insert(int(rng.integers(len(lines))), line.encode())
    return b"\n".join(lines), f"'{line[:30]}' in it"


# glTF ---------------------------------------------------------------------------------------------


def _gltf_tree(rng: Rng, tree: dict) -> str:
    """Change a number, a name or an entry of the tree."""
    places: list[tuple[dict | list, str | int]] = []

    def walk(node: object) -> None:
        items = node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ()
        for key, value in items:
            places.append((node, key))  # type: ignore[arg-type]
            walk(value)

    walk(tree)
    if rng.random() < 0.15:
        uri = some(rng, (OUTSIDE, "/etc/passwd", "file:///etc/passwd", "http://127.0.0.1:9/x", "data:;base64,AAAA", ""))
        tree["buffers"][0]["uri"] = uri
        return f"buffer at '{uri}'"
    if rng.random() < 0.1:
        tree["images"], tree["textures"] = [{"uri": OUTSIDE}], [{"source": 0}]
        tree["materials"] = [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}]
        tree["meshes"][0]["primitives"][0]["material"] = 0
        return f"a texture at '{OUTSIDE}'"
    if rng.random() < 0.1:
        tree["nodes"][0]["children"] = [0]
        return "a node in itself"
    node, key = some(rng, places)
    value = node[key]  # type: ignore[index]
    way = rng.random()
    if way < 0.2:
        del node[key]  # type: ignore[arg-type]
        return f"{key} left out"
    odd: Any = (
        odd_count(rng, value) if isinstance(value, int) else some(rng, (None, -1, 1e300, [], {}, "x", [0], 10**9))
    )
    node[key] = odd  # type: ignore[index]
    return f"{key} {str(odd)[:30]}"


def _glb(rng: Rng, data: bytes) -> _Told:
    size = struct.unpack_from("<I", data, 12)[0]
    tree, rest = json.loads(data[20 : 20 + size]), data[20 + size :]
    told = _gltf_tree(rng, tree)
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    length = 20 + len(text) + len(rest)
    if rng.random() < 0.15:
        length, told = odd_count(rng, length) % 2**32, f"{told}; a length that lies"
    head = struct.pack("<4sIIII", b"glTF", 2, length, len(text), 0x4E4F534A)
    return head + text + rest, told


@lru_cache(maxsize=1)
def _gltf_text() -> bytes:
    """Return glTF in one file, with the buffer in the text."""
    data = _exported("glb")()
    size = struct.unpack_from("<I", data, 12)[0]
    tree = json.loads(data[20 : 20 + size])
    tree["buffers"][0]["uri"] = "data:application/octet-stream;base64," + base64.b64encode(data[28 + size :]).decode()
    return json.dumps(tree).encode()


def _gltf(rng: Rng, data: bytes) -> _Told:
    tree = json.loads(data)
    told = _gltf_tree(rng, tree)
    return json.dumps(tree).encode(), told


# VTK, Gmsh, .trian --------------------------------------------------------------------------------


@lru_cache(maxsize=1)
def _vtk_text() -> bytes:
    points, triangles = _ball()
    n, t = len(points), len(triangles)
    return (
        f"# vtk DataFile Version 3.0\nball\nASCII\nDATASET POLYDATA\nPOINTS {n} float\n{_rows(points)}"
        f"POLYGONS {t} {4 * t}\n{_rows(triangles, '3 ')}"
    ).encode()


@lru_cache(maxsize=1)
def _vtk_binary() -> bytes:
    points, triangles = _ball()
    n, t = len(points), len(triangles)
    cells = np.hstack([np.full((t, 1), 3), triangles]).astype(">i4")
    return (
        f"# vtk DataFile Version 3.0\nball\nBINARY\nDATASET POLYDATA\nPOINTS {n} double\n".encode()
        + points.astype(">f8").tobytes()
        + f"\nPOLYGONS {t} {4 * t}\n".encode()
        + cells.tobytes()
        + b"\n"
    )


@lru_cache(maxsize=1)
def _vtk_5() -> bytes:
    points, triangles = _ball()
    t = len(triangles)
    offsets = " ".join(str(3 * k) for k in range(t + 1))
    return (
        f"# vtk DataFile Version 5.1\nball\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS {len(points)} double\n"
        f"{_rows(points)}CELLS {t + 1} {3 * t}\nOFFSETS vtktypeint64\n{offsets}\nCONNECTIVITY vtktypeint64\n"
        f"{_rows(triangles)}CELL_TYPES {t}\n" + "5\n" * t + f"POINT_DATA {len(points)}\nFIELD a 1\nb 1 1 float\n1\n"
    ).encode()


def _vtk_head(rng: Rng, data: bytes) -> _Told:
    """Change a count of a binary file, whose heads lie between numbers."""
    marks = [data.index(word) for word in (b"POINTS", b"POLYGONS")]
    at = some(rng, marks)
    end = data.index(b"\n", at)
    words = data[at:end].split(b" ")
    k = int(rng.integers(1, len(words)))
    words[k] = str(odd_count(rng, 162)).encode() if words[k].isdigit() else some(rng, (b"int", b"char", b"long", b"x"))
    line = b" ".join(words)
    return data[:at] + line + data[end:], f"'{line.decode()}'"


@lru_cache(maxsize=1)
def _vtp() -> bytes:
    points, triangles = _ball()

    def array(name: str, kind: str, values: NDArray) -> str:
        return f'<DataArray type="{kind}" Name="{name}" format="ascii">\n{_rows(values)}</DataArray>\n'

    ends = 3 * np.arange(1, len(triangles) + 1)[:, None]
    return (
        '<?xml version="1.0"?>\n<VTKFile type="PolyData" version="1.0" byte_order="LittleEndian">\n<PolyData>\n'
        f"<Piece>\n<Points>\n{array('p', 'Float64', points)}</Points>\n<Polys>\n"
        f"{array('connectivity', 'Int64', triangles)}{array('offsets', 'Int64', ends)}</Polys>\n"
        "</Piece>\n</PolyData>\n</VTKFile>\n"
    ).encode()


@lru_cache(maxsize=1)
def _vtu() -> bytes:
    """Return the mesh as tetrahedra that share its middle."""
    points, triangles = _ball()
    points = np.vstack([points, [0.0, 0.0, 0.0]])
    cells = np.insert(triangles, 0, len(points) - 1, axis=1).astype(np.int32)
    return tetrahedra(points, cells, {}, {})


@lru_cache(maxsize=1)
def _gmsh_1() -> bytes:
    points, triangles = _ball()
    elements = "".join(f"{k} 2 1 1 3 {a + 1} {b + 1} {c + 1}\n" for k, (a, b, c) in enumerate(triangles, 1))
    return f"$NOD\n{_numbered(points)}$ENDNOD\n$ELM\n{len(triangles)}\n{elements}$ENDELM\n".encode()


@lru_cache(maxsize=1)
def _gmsh_2() -> bytes:
    points, triangles = _ball()
    elements = "".join(f"{k} 2 2 1 1 {a + 1} {b + 1} {c + 1}\n" for k, (a, b, c) in enumerate(triangles, 1))
    return (
        f"$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n{_numbered(points)}$EndNodes\n"
        f"$Elements\n{len(triangles)}\n{elements}$EndElements\n"
    ).encode()


@lru_cache(maxsize=1)
def _gmsh_4() -> bytes:
    """Return tetrahedra: a fan around the centre."""
    points, triangles = _ball()
    points = np.vstack([points, [0.0, 0.0, 0.0]])
    n, t = len(points), len(triangles)
    tags = "\n".join(str(k + 1) for k in range(n))
    elements = "".join(f"{k} {n} {a + 1} {b + 1} {c + 1}\n" for k, (a, b, c) in enumerate(triangles, 1))
    return (
        f"$MeshFormat\n4.1 0 8\n$EndMeshFormat\n$Nodes\n1 {n} 1 {n}\n3 1 0 {n}\n{tags}\n{_rows(points)}$EndNodes\n"
        f"$Elements\n1 {t} 1 {t}\n3 1 4 {t}\n{elements}$EndElements\n"
    ).encode()


def _numbered(points: Floats) -> str:
    return f"{len(points)}\n" + "".join(f"{k} {x:g} {y:g} {z:g}\n" for k, (x, y, z) in enumerate(points, 1))


@lru_cache(maxsize=1)
def _trian() -> bytes:
    points, triangles = _ball()
    return f"{len(points)}\n{_rows(points)}{len(triangles)}\n{_rows(triangles)}".encode()


_FORMS = (
    Form("STL", ".stl", _exported("stl"), _stl),
    Form("STL as text", ".stl", _exported("stl_ascii"), _text),
    Form("PLY", ".ply", _exported("ply"), _ply),
    Form("PLY as text", ".ply", _exported("ply", encoding="ascii"), _ply),
    Form("OFF", ".off", _exported("off"), _text),
    Form("OBJ", ".obj", _exported("obj"), _obj),
    Form("GLB", ".glb", _exported("glb"), _glb),
    Form("glTF", ".gltf", _gltf_text, _gltf),
    Form("VTK", ".vtk", _vtk_text, _text),
    Form("VTK, binary", ".vtk", _vtk_binary, _vtk_head),
    Form("VTK 5.1", ".vtk", _vtk_5, _text),
    Form("VTK XML", ".vtp", _vtp, _text),
    Form("VTK XML, binary", ".vtu", _vtu, _text),
    Form("Gmsh 1", ".msh", _gmsh_1, _text),
    Form("Gmsh 2.2", ".msh", _gmsh_2, _text),
    Form("Gmsh 4.1", ".msh", _gmsh_4, _text),
    Form(".trian", ".trian", _trian, _text),
)
