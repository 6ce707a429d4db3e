"""Triangles from mesh files: trimesh's formats, meshio's Gmsh, and readers for Gmsh 1, VTK and SOFA's .trian.

No library that is small reads the last three as they occur: meshio 5.3 takes neither POLYDATA nor Gmsh 1, and VTK
itself weighs 100 MB.
"""

from __future__ import annotations

import logging
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

from tissue_sim.array_types import Array, Floats, Longs
from tissue_sim.errors import shown
from tissue_sim.memory import limited
from tissue_sim.organ.imaging.itk_output import silenced
from tissue_sim.organ.meshes import cell_surface, vtk_xml_input

logging.getLogger("trimesh").addHandler(logging.NullHandler())  # otherwise trimesh prints what it tolerates

_TRIMESH = (".glb", ".gltf", ".obj", ".off", ".ply", ".stl")
# glTF 2.0, 3.4: +Y up, +Z forward, -X right; so these rows take it to LPS (x left, y back, z up).
GLTF_TO_LPS = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])


@dataclass(frozen=True, eq=False)
class Piece:
    """One named piece of a file.

    Attributes
    ----------
    name : str
        Name in the file, or an empty string.
    positions : Floats, shape (n, 3), in the file's unit
        Points.
    triangles : Longs, shape (t, 3)
        Corner indices.
    """

    name: str
    positions: Floats
    triangles: Longs


@dataclass(frozen=True, eq=False)
class MeshFile:
    """Content of a mesh file.

    Attributes
    ----------
    pieces : tuple[Piece, ...]
        Its named pieces.
    notes : tuple[str, ...]
        Remarks on how it was read, one line each.
    """

    pieces: tuple[Piece, ...]
    notes: tuple[str, ...] = ()


def read_pieces(source: Path) -> MeshFile:
    """Read a mesh file of one of `FORMATS` by its suffix; the points keep their order.

    Polygons become fans of triangles, tetrahedra their surface. glTF is turned from its own axes (y up, z forward) into
    the patient frame, and so is VTK that says `SPACE=RAS`.

    Parameters
    ----------
    source : Path
        The file.

    Returns
    -------
    MeshFile
        Its pieces and remarks.

    Raises
    ------
    ValueError
        Where the file doesn't hold what its format requires; trimesh raises other errors on damaged files.
    """
    suffix = source.suffix.lower()
    return _READERS[suffix](source)


def _read_trimesh(source: Path) -> MeshFile:
    # NaN and infinity are checked later.
    with np.errstate(all="ignore"):
        return _pieces(_load_trimesh(source), source.suffix.lower())


def _load_trimesh(source: Path) -> Any:
    options: dict[str, Any] = {"process": False, "maintain_order": True}
    if source.suffix.lower() != ".glb":
        return trimesh.load(source, **options)
    # Read from memory: from a file, trimesh would request as much memory as a chunk claims to hold.
    resolver = trimesh.resolvers.FilePathResolver(str(source))
    return trimesh.load(BytesIO(source.read_bytes()), file_type="glb", resolver=resolver, **options)


def _pieces(loaded: Any, suffix: str) -> MeshFile:
    if not isinstance(loaded, trimesh.Scene):
        return MeshFile((_piece(loaded, "", np.eye(4)),))
    pieces = []
    for node in loaded.graph.nodes_geometry:
        transform, geometry = loaded.graph[node]
        mesh = loaded.geometry[geometry]
        if isinstance(mesh, trimesh.Trimesh) and len(mesh.faces):
            pieces.append(_piece(mesh, str(node), transform))
    if suffix not in (".glb", ".gltf"):
        return MeshFile(tuple(pieces))
    turned = tuple(Piece(p.name, p.positions @ GLTF_TO_LPS.T, p.triangles) for p in pieces)
    return MeshFile(turned, ("glTF has y up and z to the front: rotated into the patient frame (z to the head)",))


def _piece(mesh: Any, name: str, transform: Floats) -> Piece:
    if not isinstance(mesh, trimesh.Trimesh):
        raise ValueError("no triangles")
    positions = np.array(mesh.vertices, dtype=np.float64)
    if not np.array_equal(transform, np.eye(4)):
        positions = positions @ transform[:3, :3].T + transform[:3, 3]
    triangles = np.array(mesh.faces, dtype=np.int64)
    if np.linalg.det(transform[:3, :3]) < 0.0:
        triangles = triangles[:, ::-1]
    return Piece(name, positions, triangles)


class _Words:
    """Cursor over a file of words and numbers, as text or (VTK) big-endian binary."""

    def __init__(self, data: bytes, at: int = 0) -> None:
        self.data, self.at, self.binary = data, at, False

    def line(self) -> str:
        """Return the rest of the line."""
        end = self.data.find(b"\n", self.at)
        end = len(self.data) if end < 0 else end
        text = self.data[self.at : end].decode("ascii", "replace").strip()
        self.at = end + 1
        return text

    def word(self) -> str:
        """Return the next word; empty at the end."""
        match = _WORD.match(self.data, self.at)
        if match is None:
            self.at = len(self.data)
            return ""
        self.at = match.end()
        return match[1].decode("ascii", "replace")

    def count(self) -> int:
        """Return the next word as a count."""
        value = int(self.word())
        if value < 0:
            raise ValueError("a negative count")
        return value

    def numbers(self, count: int, kind: str) -> Array:
        """Return the next `count` numbers of a numpy type such as `f4`."""
        if self.binary:
            self.at += 1  # the line's end
            found = np.frombuffer(self.data, ">" + kind, count, self.at)
            self.at += found.nbytes
            return found.astype(kind)
        parts = self.data[self.at :].split(None, count)
        if len(parts) < count:
            raise ValueError("the file ends early")
        self.at = len(self.data) - (len(parts[count]) if len(parts) > count else 0)
        return _cast(np.array(parts[:count], dtype="f8"), kind)

    def skip_strings(self, count: int) -> None:
        """Skip VTK strings: one per line, or in binary each after its length."""
        self.line()
        for _ in range(count):
            if self.binary:
                width = 1 << 3 - (self.data[self.at] >> 6)  # bytes of the length, whose first two bits say how many
                length = int.from_bytes(self.data[self.at : self.at + width], "big") & ((1 << 8 * width - 2) - 1)
                self.at += width + length
            else:
                self.line()


def _cast(values: Floats, kind: str) -> Array:
    """Return numbers as a numpy type; raises ValueError for invalid ones, turns those too large into infinity."""
    if np.dtype(kind).kind in "iu":
        limits = np.iinfo(kind)
        if not np.all((values >= float(limits.min)) & (values < float(limits.max) + 1.0)):
            raise ValueError("an invalid number among counts and indices")
    with np.errstate(over="ignore"):
        return values.astype(kind)


_WORD = re.compile(rb"\s*(\S+)")


def _read_trian(source: Path) -> MeshFile:
    """Read SOFA's .trian: number of points, coordinates, number of triangles, corners (and neighbours)."""
    words = _Words(source.read_bytes())
    n = words.count()
    positions = words.numbers(3 * n, "f8").reshape(n, 3)
    count = words.count()
    rest = np.array(words.data[words.at :].split(), dtype=np.int64)
    width = 6 if len(rest) == 6 * count else 3
    triangles = rest.reshape(count, width)[:, :3]
    return MeshFile((Piece("", positions, triangles),))


# Gmsh -----------------------------------------------------------------------------------------

_GMSH_KINDS = {  # of version 1, as meshio names them
    2: "triangle",
    3: "quad",
    4: "tetra",
    5: "hexahedron",
    6: "wedge",
    7: "pyramid",
    9: "triangle6",
    10: "quad9",
    11: "tetra10",
    16: "quad8",
}
_ROOM, _ROOM_PER_BYTE = 1 << 28, 64  # bytes that reading a file may need, whatever its counts say


def _read_gmsh(source: Path) -> MeshFile:
    """Read Gmsh's .msh: text of version 1, text and binary of versions 2 and 4."""
    text = source.read_bytes()
    if text.lstrip()[:4].upper() == b"$NOD":
        positions, cells = _gmsh_1(text)
    else:
        from meshio import gmsh

        try:
            with silenced(), np.errstate(all="ignore"), limited(_ROOM + _ROOM_PER_BYTE * len(text)):
                mesh = gmsh.read(source)
        except MemoryError:
            raise ValueError("a count larger than the file can contain") from None
        positions, cells = np.asarray(mesh.points, dtype=np.float64), mesh.cells_dict
    return _surface_of_cells(positions, cells)


def _gmsh_1(text: bytes) -> tuple[Floats, dict[str, Longs]]:
    """Return points, and corner indices by kind of element, of lines `number type region region count nodes`."""
    sections = {m[1].upper(): m[2] for m in re.finditer(rb"\$(\w+)\s(.*?)\$End\1", text, re.DOTALL | re.IGNORECASE)}
    if not {b"NOD", b"ELM"} <= sections.keys():
        raise ValueError("no nodes and elements")
    words = sections[b"NOD"].split()
    table = np.array(words[1 : 1 + 4 * int(words[0])], dtype=np.float64).reshape(int(words[0]), 4)
    place = {int(tag): k for k, tag in enumerate(_cast(table[:, 0], "i8"))}
    found: dict[str, list[list[int]]] = {}
    numbers = [int(word) for word in sections[b"ELM"].split()]
    at = 1
    for _ in range(numbers[0]):
        kind, count = _GMSH_KINDS.get(numbers[at + 1], ""), numbers[at + 4]
        nodes = numbers[at + 5 : at + 5 + count]
        if not all(node in place for node in nodes):
            raise ValueError("an element names a node that doesn't exist")
        found.setdefault(kind, []).append([place[node] for node in nodes])
        at += 5 + count
    return table[:, 1:], {kind: np.array(rows, dtype=np.int64) for kind, rows in found.items() if kind}


# VTK legacy -----------------------------------------------------------------------------------

_VTK_TYPES = {
    "float": "f4",
    "double": "f8",
    "int": "i4",
    "long": "i8",
    "vtkidtype": "i8",
    "vtktypeint64": "i8",
    "unsigned_int": "u4",
    "unsigned_long": "u8",
    "short": "i2",
    "unsigned_short": "u2",
    "char": "i1",
    "unsigned_char": "u1",
    "vtktypeint32": "i4",
    "vtktypeint8": "i1",
    "vtktypeuint8": "u1",
    "vtktypeuint32": "u4",
    "vtktypeuint64": "u8",
    "signed_char": "i1",
}
_VTK_LINES = ("string", "variant")  # written one a line


def _read_vtk(source: Path) -> MeshFile:
    """Read legacy VTK, text or binary, versions 1 to 5.1: polygons, strips, or cells of UNSTRUCTURED_GRID."""
    words = _Words(source.read_bytes())
    if "vtk datafile" not in words.line().lower():
        raise ValueError("not a VTK file")
    title = words.line()
    words.binary = words.word().upper() == "BINARY"
    positions, kinds = np.empty((0, 3)), None
    cells: dict[str, tuple[Longs, Longs]] = {}
    while word := words.word().upper():
        if word == "DATASET":
            if (dataset := words.word().upper()) not in ("POLYDATA", "UNSTRUCTURED_GRID"):
                raise ValueError(f"a VTK {dataset}, not a surface")
        elif word == "POINTS":
            count = words.count()
            positions = words.numbers(3 * count, _vtk_type(words.word())).reshape(count, 3).astype("f8")
        elif word in ("VERTICES", "LINES", "POLYGONS", "TRIANGLE_STRIPS", "CELLS"):
            cells[word] = _vtk_cells(words)
        elif word == "CELL_TYPES":
            kinds = words.numbers(words.count(), "i4")
        elif word == "FIELD":
            _skip_field(words)
        elif word == "METADATA":
            _skip_metadata(words)
        elif word in ("POINT_DATA", "CELL_DATA"):
            break
    is_ras = "SPACE=RAS" in title.upper().replace(" ", "")
    return _vtk_surface(positions, cells, kinds, is_ras)


def _read_vtk_xml(source: Path) -> MeshFile:
    """VTK's XML: polygons and strips of .vtp, or cells of .vtu."""
    data = source.read_bytes()
    try:
        with np.errstate(all="ignore"), limited(_ROOM + _ROOM_PER_BYTE * len(data)):
            grid = vtk_xml_input.read(data)
    except MemoryError:
        raise ValueError("a count that is more than the file can hold") from None
    return _vtk_surface(grid.positions, grid.faces, grid.kinds, "RAS" in grid.space)


# Cells that bound nothing or are bounds of nothing: empty, points, lines and curves.
_VTK_IGNORED = (0, 1, 2, 3, 4, 21)
_VTK_CELLS = {
    5: "triangle",
    9: "quad",
    10: "tetra",
    12: "hexahedron",
    13: "wedge",
    14: "pyramid",
    22: "triangle6",
    23: "quad8",
    24: "tetra10",
    25: "hexahedron20",
    28: "quad9",
}


def _vtk_surface(
    positions: Floats, cells: Mapping[str, tuple[Longs, Longs]], kinds: Longs | None, is_ras: bool
) -> MeshFile:
    """Return the surface of faces or cells, by the names of their sections; kinds: of CELLS."""
    if is_ras:
        positions = positions * np.array([-1.0, -1.0, 1.0])
    if kinds is not None and "CELLS" in cells:
        offsets, corners = cells["CELLS"]
        other = set(kinds.tolist()) - set(_VTK_CELLS) - set(_VTK_IGNORED)
        if other:
            raise ValueError(f"cells of VTK's type {min(other)}: triangulate them first")
        widths = {kind: np.diff(offsets)[kinds == kind] for kind in _VTK_CELLS if np.any(kinds == kind)}
        named = {
            _VTK_CELLS[kind]: _rows(offsets, corners, kinds == kind, int(width.min())) for kind, width in widths.items()
        }
        found = _surface_of_cells(positions, named)
    else:
        faces = [split(*cells[word]) for word, split in _VTK_FACES.items() if word in cells]
        if not faces:
            raise ValueError("no polygons")
        found = MeshFile((Piece("", positions, np.concatenate(faces)),))
    return MeshFile(found.pieces, (*found.notes, "converted from RAS to LPS")) if is_ras else found


def _vtk_type(word: str) -> str:
    """Return the numpy type of a VTK type."""
    if word.lower() not in _VTK_TYPES:
        raise ValueError(f"numbers of the type {shown(word)}")
    return _VTK_TYPES[word.lower()]


def _vtk_cells(words: _Words) -> tuple[Longs, Longs]:
    """Return the offsets (cells + 1,) and corners of a cell section, in the layout of version 5 or the one before."""
    first, second = words.count(), words.count()
    start = words.at
    if words.word().upper() == "OFFSETS":
        offsets = words.numbers(first, _vtk_type(words.word())).astype(np.int64)
        words.word()  # CONNECTIVITY
        return offsets, words.numbers(second, _vtk_type(words.word())).astype(np.int64)
    words.at = start
    if first > second:
        raise ValueError("more polygons than numbers to describe them")
    flat = words.numbers(second, "i4").astype(np.int64)
    offsets = np.zeros(first + 1, dtype=np.int64)
    marks = np.zeros(first, dtype=np.int64)
    at = 0
    for k in range(first):
        marks[k] = at
        offsets[k + 1] = offsets[k] + flat[at]
        at += int(flat[at]) + 1
    return offsets, np.delete(flat, marks)


def _skip_field(words: _Words) -> None:
    words.word()
    for _ in range(words.count()):
        if words.word().upper() == "METADATA":  # of the array before
            _skip_metadata(words)
            words.word()
        count, kind = words.count() * words.count(), words.word().lower()
        if kind in _VTK_LINES:
            words.skip_strings(count)
        elif kind == "bit":
            words.numbers((count + 7) // 8 if words.binary else count, "i1")
        else:
            words.numbers(count, _vtk_type(kind))


def _skip_metadata(words: _Words) -> None:
    end = words.data.find(b"\n\n", words.at)
    words.at = len(words.data) if end < 0 else end


def _fans(offsets: Longs, corners: Longs) -> Longs:
    """Return the triangles (t, 3) of polygons: each a fan around its first corner."""
    return _split(offsets, corners, lambda k: [0, k + 1, k + 2])


def _strips(offsets: Longs, corners: Longs) -> Longs:
    """Return the triangles (t, 3) of strips: each corner from the third on joins the two before, alternately turned."""
    return _split(offsets, corners, lambda k: [k, k + 1, k + 2] if k % 2 == 0 else [k + 1, k, k + 2])


_VTK_FACES = {"POLYGONS": _fans, "TRIANGLE_STRIPS": _strips}


def _split(offsets: Longs, corners: Longs, triangle: Callable[[int], list[int]]) -> Longs:
    """Return the triangles of faces of any number of corners; triangle: which corners of a face its k-th has."""
    size = np.diff(offsets)
    if np.any(size < 3):
        raise ValueError("polygons with fewer than three corners")
    found = []
    for width in np.unique(size):
        rows = _rows(offsets, corners, size == width, int(width))
        found.append(np.stack([rows[:, triangle(k)] for k in range(int(width) - 2)], axis=1).reshape(-1, 3))
    return np.concatenate(found) if found else np.empty((0, 3), dtype=np.int64)


def _rows(offsets: Longs, corners: Longs, chosen: NDArray[np.bool_], width: int) -> Longs:
    return corners[offsets[:-1][chosen][:, None] + np.arange(width)]


def _surface_of_cells(positions: Floats, cells: Mapping[str, Longs]) -> MeshFile:
    """Return the surface of cells by meshio's names, see `cell_surface`."""
    points, triangles, notes = cell_surface.surface_of(positions, cells)
    return MeshFile((Piece("", points, triangles),), notes)


_READERS: dict[str, Callable[[Path], MeshFile]] = {
    **dict.fromkeys(_TRIMESH, _read_trimesh),
    ".msh": _read_gmsh,
    ".trian": _read_trian,
    ".vtk": _read_vtk,
    ".vtp": _read_vtk_xml,
    ".vtu": _read_vtk_xml,
}
FORMATS = tuple(sorted(_READERS))
