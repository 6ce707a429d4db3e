"""Triangles from mesh files: trimesh's formats, and readers for VTK (legacy), Gmsh and SOFA's .trian.

No kept library reads the last three as they occur: meshio 5.3 takes neither POLYDATA nor Gmsh 1, and VTK itself
weighs 100 MB.
"""

from __future__ import annotations

import logging
import re
from collections.abc import Callable
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

from tissue_sim.array_types import Floats, Longs

logging.getLogger("trimesh").addHandler(logging.NullHandler())  # else it prints what it puts up with

_TRIMESH = (".glb", ".gltf", ".obj", ".off", ".ply", ".stl")
# glTF 2.0, 3.4: +Y up, +Z forward, -X right; so these rows take it to LPS (x left, y back, z up).
_GLTF_TO_LPS = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])


@dataclass(frozen=True, eq=False)
class Piece:
    """One named piece of a file: positions (n, 3) in the file's unit, triangles (t, 3)."""

    name: str
    positions: Floats
    triangles: Longs


@dataclass(frozen=True, eq=False)
class MeshFile:
    """What a mesh file holds, and remarks on how it was read, one line each."""

    pieces: tuple[Piece, ...]
    notes: tuple[str, ...] = ()


def read_pieces(source: Path) -> MeshFile:
    """Read a mesh file of one of `FORMATS` by its suffix; the points keep their order.

    Polygons become fans of triangles, tetrahedra their surface. glTF is turned from its own axes (y up, z forward)
    into the patient frame, and so is VTK that says `SPACE=RAS`. Raises ValueError when the file doesn't hold
    what its format asks for, and whatever trimesh raises on damaged files.
    """
    suffix = source.suffix.lower()
    return _READERS[suffix](source)


def _read_trimesh(source: Path) -> MeshFile:
    # Numbers that are none are looked for later.
    with np.errstate(all="ignore"):
        return _pieces(_load_trimesh(source), source.suffix.lower())


def _load_trimesh(source: Path) -> Any:
    options: dict[str, Any] = {"process": False, "maintain_order": True}
    if source.suffix.lower() != ".glb":
        return trimesh.load(source, **options)
    # From memory: of a file it would ask for room for as much as a chunk says that it is long.
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
    turned = tuple(Piece(p.name, p.positions @ _GLTF_TO_LPS.T, p.triangles) for p in pieces)
    return MeshFile(turned, ("glTF is y up, z to the front: turned into the patient frame (z to the head)",))


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
    """A cursor over a file of words and numbers, text or (VTK) big-endian binary."""

    def __init__(self, data: bytes, at: int = 0) -> None:
        self.data, self.at, self.binary = data, at, False

    def line(self) -> str:
        """The rest of the line."""
        end = self.data.find(b"\n", self.at)
        end = len(self.data) if end < 0 else end
        text = self.data[self.at : end].decode("ascii", "replace").strip()
        self.at = end + 1
        return text

    def word(self) -> str:
        """The next word; empty at the end."""
        match = _WORD.match(self.data, self.at)
        if match is None:
            self.at = len(self.data)
            return ""
        self.at = match.end()
        return match[1].decode("ascii", "replace")

    def count(self) -> int:
        """The next word as a number of things."""
        value = int(self.word())
        if value < 0:
            raise ValueError("a negative count")
        return value

    def numbers(self, count: int, kind: str) -> NDArray[Any]:
        """The next `count` numbers of a numpy type like `f4`."""
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


def _cast(values: Floats, kind: str) -> NDArray[Any]:
    """Numbers as a numpy type; raises ValueError where they are none of it, and makes infinity of what is too large."""
    if np.dtype(kind).kind in "iu":
        limits = np.iinfo(kind)
        if not np.all((values >= float(limits.min)) & (values < float(limits.max) + 1.0)):
            raise ValueError("a number that can't be, where counts and indices are")
    with np.errstate(over="ignore"):
        return values.astype(kind)


_WORD = re.compile(rb"\s*(\S+)")


def _read_trian(source: Path) -> MeshFile:
    """SOFA's .trian: number of points, their coordinates, number of triangles, their corners (and neighbours)."""
    words = _Words(source.read_bytes())
    n = words.count()
    positions = words.numbers(3 * n, "f8").reshape(n, 3)
    count = words.count()
    rest = np.array(words.data[words.at :].split(), dtype=np.int64)
    width = 6 if len(rest) == 6 * count else 3
    triangles = rest.reshape(count, width)[:, :3]
    return MeshFile((Piece("", positions, _checked(triangles, n)),))


# Gmsh -----------------------------------------------------------------------------------------

_GMSH_NODES = {1: 2, 2: 3, 3: 4, 4: 4, 5: 8, 6: 6, 7: 5, 8: 3, 9: 6, 10: 9, 11: 10, 15: 1}  # nodes of each type
_TRIANGLE, _QUAD, _TETRA = 2, 3, 4


def _read_gmsh(source: Path) -> MeshFile:
    """Gmsh's .msh, text, of versions 1, 2 and 4.1."""
    text = source.read_bytes()
    sections = {m[1].decode(): m[2] for m in re.finditer(rb"\$(\w+)\s(.*?)\$End\1", text, re.DOTALL | re.IGNORECASE)}
    if "NOD" in sections and "ELM" in sections:
        tags, positions = _gmsh_nodes(sections["NOD"])
        cells = _gmsh_elements(sections["ELM"], version=1)
    elif "MeshFormat" in sections:
        version, binary = sections["MeshFormat"].split()[:2]
        if binary != b"0":
            raise ValueError("binary Gmsh; save it as text (Mesh.Binary = 0)")
        if version.startswith(b"2"):
            tags, positions = _gmsh_nodes(sections["Nodes"])
            cells = _gmsh_elements(sections["Elements"], version=2)
        elif version == b"4.1":
            tags, positions, cells = _gmsh_4(sections)
        else:
            raise ValueError(f"Gmsh version {version.decode()}; save it as version 2.2")
    else:
        raise ValueError("no nodes and elements")
    order = np.argsort(tags)
    place = {}
    for kind, nodes in cells.items():
        flat = np.array(nodes, dtype=np.int64)
        at = np.clip(np.searchsorted(tags, flat, sorter=order), 0, len(tags) - 1)
        if not np.array_equal(tags[order[at]], flat):
            raise ValueError("an element names a node that isn't there")
        place[kind] = order[at].reshape(-1, _GMSH_NODES[kind])
    return _surface_of_cells(positions, place.get(_TRIANGLE), place.get(_QUAD), place.get(_TETRA))


def _gmsh_nodes(section: bytes) -> tuple[Longs, Floats]:
    words = section.split()
    table = np.array(words[1 : 1 + 4 * int(words[0])], dtype=np.float64).reshape(int(words[0]), 4)
    return _cast(table[:, 0], "i8"), np.ascontiguousarray(table[:, 1:])


def _gmsh_elements(section: bytes, version: int) -> dict[int, list[int]]:
    """Nodes by element type. Version 1: number type region region count nodes; 2: number type count tags nodes."""
    cells: dict[int, list[int]] = {}
    words = [int(word) for word in section.split()]
    at = 1
    for _ in range(words[0]):
        kind = words[at + 1]
        first = at + (5 if version == 1 else 3 + words[at + 2])
        count = words[at + 4] if version == 1 else _GMSH_NODES[kind]
        if kind in (_TRIANGLE, _QUAD, _TETRA):
            cells.setdefault(kind, []).extend(words[first : first + count])
        at = first + count
    return cells


def _gmsh_4(sections: dict[str, bytes]) -> tuple[Longs, Floats, dict[int, list[int]]]:
    words = sections["Nodes"].split()
    tags, places, at = [], [], 4
    for _ in range(int(words[0])):
        parametric, count = int(words[at + 2]), int(words[at + 3])
        width = 3 + (int(words[at]) if parametric else 0)
        at += 4
        tags.append(np.array(words[at : at + count], dtype=np.int64))
        at += count
        places.append(np.array(words[at : at + count * width], dtype=np.float64).reshape(count, width)[:, :3])
        at += count * width
    cells: dict[int, list[int]] = {}
    words = sections["Elements"].split()
    at = 4
    for _ in range(int(words[0])):
        kind, count = int(words[at + 2]), int(words[at + 3])
        width = 1 + _GMSH_NODES[kind]
        table = np.array(words[at + 4 : at + 4 + count * width], dtype=np.int64).reshape(count, width)
        if kind in (_TRIANGLE, _QUAD, _TETRA):
            cells.setdefault(kind, []).extend(table[:, 1:].ravel().tolist())
        at += 4 + count * width
    return np.concatenate(tags), np.concatenate(places), cells


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
}


def _read_vtk(source: Path) -> MeshFile:
    """Legacy VTK, text or binary, versions 1 to 5.1: the polygons of POLYDATA or the cells of UNSTRUCTURED_GRID."""
    words = _Words(source.read_bytes())
    if "vtk datafile" not in words.line().lower():
        raise ValueError("no VTK file")
    title = words.line()
    words.binary = words.word().upper() == "BINARY"
    positions, cells, kinds = np.empty((0, 3)), None, None
    while word := words.word().upper():
        if word == "DATASET":
            if (dataset := words.word().upper()) not in ("POLYDATA", "UNSTRUCTURED_GRID"):
                raise ValueError(f"a VTK {dataset}, no surface")
        elif word == "POINTS":
            count = words.count()
            positions = words.numbers(3 * count, _VTK_TYPES[words.word().lower()]).reshape(count, 3).astype("f8")
        elif word in ("VERTICES", "LINES", "POLYGONS", "CELLS"):
            offsets, corners = _vtk_cells(words)
            if word in ("POLYGONS", "CELLS"):
                cells = (offsets, corners)
        elif word == "CELL_TYPES":
            kinds = words.numbers(words.count(), "i4")
        elif word == "TRIANGLE_STRIPS":
            raise ValueError("triangle strips; save it as triangles")
        elif word == "FIELD":
            _skip_field(words)
        elif word == "METADATA":
            end = words.data.find(b"\n\n", words.at)
            words.at = len(words.data) if end < 0 else end
        elif word in ("POINT_DATA", "CELL_DATA"):
            break
    if cells is None:
        raise ValueError("no polygons")
    space = "RAS" if "SPACE=RAS" in title.upper().replace(" ", "") else ""
    if space:
        positions = positions * np.array([-1.0, -1.0, 1.0])
    offsets, corners = cells
    corners = _checked(corners, len(positions))
    if kinds is None:
        found = MeshFile((Piece("", positions, _fans(offsets, corners)),))
    else:
        parts = [_rows(offsets, corners, kinds == kind, width) for kind, width in ((5, 3), (9, 4), (10, 4))]
        found = _surface_of_cells(positions, *parts)
    return MeshFile(found.pieces, (*found.notes, "turned from RAS to LPS")) if space else found


def _vtk_cells(words: _Words) -> tuple[Longs, Longs]:
    """Offsets (cells + 1,) and corners of a cell section, in the layout of version 5 or the one before."""
    first, second = words.count(), words.count()
    start = words.at
    if words.word().upper() == "OFFSETS":
        offsets = words.numbers(first, _VTK_TYPES[words.word().lower()]).astype(np.int64)
        words.word()  # CONNECTIVITY
        return offsets, words.numbers(second, _VTK_TYPES[words.word().lower()]).astype(np.int64)
    words.at = start
    if first > second:
        raise ValueError("more polygons than numbers that describe them")
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
        words.word()
        parts, count = words.count(), words.count()
        words.numbers(parts * count, _VTK_TYPES[words.word().lower()])


def _fans(offsets: Longs, corners: Longs) -> Longs:
    size = np.diff(offsets)
    if np.any(size < 3):
        raise ValueError("polygons with fewer than three corners")
    fans = []
    for width in np.unique(size):
        rows = _rows(offsets, corners, size == width, int(width))
        fans.append(np.stack([rows[:, [0, k, k + 1]] for k in range(1, int(width) - 1)], axis=1).reshape(-1, 3))
    return np.concatenate(fans) if fans else np.empty((0, 3), dtype=np.int64)


def _rows(offsets: Longs, corners: Longs, chosen: NDArray[np.bool_], width: int) -> Longs:
    return corners[offsets[:-1][chosen][:, None] + np.arange(width)]


def _surface_of_cells(positions: Floats, triangles: Any, quads: Any, tetras: Any) -> MeshFile:
    """The boundary of the tetrahedra where there are any, else the triangles and quads."""
    if tetras is not None and len(tetras):
        corner = positions[tetras]
        along = np.einsum(
            "ij,ij->i",
            np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]),
            corner[:, 3] - corner[:, 0],
        )
        tetras = np.where((along < 0.0)[:, None], tetras[:, [0, 2, 1, 3]], tetras)
        faces = np.concatenate([tetras[:, k] for k in ([1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1])])
        _, first, count = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
        boundary = faces[np.sort(first[count == 1])]
        used, inverse = np.unique(boundary, return_inverse=True)
        note = f"took the surface of {len(tetras)} tetrahedra"
        return MeshFile((Piece("", positions[used], inverse.reshape(-1, 3).astype(np.int64)),), (note,))
    found = [] if triangles is None else [triangles]
    if quads is not None and len(quads):
        found += [quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]
    if not found:
        raise ValueError("no triangles and no tetrahedra")
    return MeshFile((Piece("", positions, np.concatenate(found)),))


def _checked(index: Longs, count: int) -> Longs:
    if index.size and (index.min() < 0 or index.max() >= count):
        raise ValueError("a triangle names a point that isn't there")
    return index


_READERS: dict[str, Callable[[Path], MeshFile]] = {
    **dict.fromkeys(_TRIMESH, _read_trimesh),
    ".msh": _read_gmsh,
    ".trian": _read_trian,
    ".vtk": _read_vtk,
}
FORMATS = tuple(sorted(_READERS))
