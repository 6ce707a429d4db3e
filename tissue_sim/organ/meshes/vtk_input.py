"""Surfaces from VTK files, legacy and XML: polygons, strips, and cells of UNSTRUCTURED_GRID."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from tissue_sim.array_types import Floats, Longs, Mask
from tissue_sim.errors import shown
from tissue_sim.memory import limited
from tissue_sim.organ.meshes import vtk_xml_input
from tissue_sim.organ.meshes.mesh_error import MeshError
from tissue_sim.organ.meshes.mesh_file import ROOM, ROOM_PER_BYTE, MeshFile, Piece, surface_of_cells
from tissue_sim.organ.meshes.words import Words

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


def read_vtk(source: Path) -> MeshFile:
    """Read legacy VTK, text or binary, versions 1 to 5.1: polygons, strips, or cells of UNSTRUCTURED_GRID.

    Parameters
    ----------
    source : Path
        The file.

    Raises
    ------
    ValueError
        Where the file doesn't hold what its format requires.
    """
    words = Words(source.read_bytes())
    if "vtk datafile" not in words.line().lower():
        raise MeshError("not a VTK file")
    title = words.line()
    words.binary = words.word().upper() == "BINARY"
    positions, kinds = np.empty((0, 3)), None
    cells: dict[str, tuple[Longs, Longs]] = {}
    while word := words.word().upper():
        if word == "DATASET":
            if (dataset := words.word().upper()) not in ("POLYDATA", "UNSTRUCTURED_GRID"):
                raise MeshError(f"a VTK {dataset}, not a surface")
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


def read_vtk_xml(source: Path) -> MeshFile:
    """Read VTK's XML: polygons and strips of .vtp, or cells of .vtu.

    Parameters
    ----------
    source : Path
        The file.

    Raises
    ------
    ValueError
        Where the file doesn't hold what its format requires.
    """
    data = source.read_bytes()
    try:
        with np.errstate(all="ignore"), limited(ROOM + ROOM_PER_BYTE * len(data)):
            grid = vtk_xml_input.read(data)
    except MemoryError:
        raise MeshError("a count that is more than the file can hold") from None
    return _vtk_surface(grid.positions, grid.faces, grid.kinds, "RAS" in grid.space)


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
            raise MeshError(f"cells of VTK's type {min(other)}: triangulate them first")
        widths = {kind: np.diff(offsets)[kinds == kind] for kind in _VTK_CELLS if np.any(kinds == kind)}
        named = {
            _VTK_CELLS[kind]: _rows(offsets, corners, kinds == kind, int(width.min())) for kind, width in widths.items()
        }
        found = surface_of_cells(positions, named)
    else:
        faces = [split(*cells[word]) for word, split in _VTK_FACES.items() if word in cells]
        if not faces:
            raise MeshError("no polygons")
        found = MeshFile((Piece("", positions, np.concatenate(faces)),))
    return MeshFile(found.pieces, (*found.notes, "converted from RAS to LPS")) if is_ras else found


def _vtk_type(word: str) -> str:
    """Return the numpy type of a VTK type."""
    if word.lower() not in _VTK_TYPES:
        raise MeshError(f"numbers of the type {shown(word)}")
    return _VTK_TYPES[word.lower()]


def _vtk_cells(words: Words) -> tuple[Longs, Longs]:
    """Return the offsets (cells + 1,) and corners of a cell section, in the layout of version 5 or the one before."""
    first, second = words.count(), words.count()
    start = words.at
    if words.word().upper() == "OFFSETS":
        offsets = words.numbers(first, _vtk_type(words.word())).astype(np.int64)
        words.word()  # CONNECTIVITY
        return offsets, words.numbers(second, _vtk_type(words.word())).astype(np.int64)
    words.at = start
    if first > second:
        raise MeshError("more polygons than numbers to describe them")
    flat = words.numbers(second, "i4").astype(np.int64)
    offsets = np.zeros(first + 1, dtype=np.int64)
    marks = np.zeros(first, dtype=np.int64)
    at = 0
    for k in range(first):
        marks[k] = at
        offsets[k + 1] = offsets[k] + flat[at]
        at += int(flat[at]) + 1
    return offsets, np.delete(flat, marks)


def _skip_field(words: Words) -> None:
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


def _skip_metadata(words: Words) -> None:
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
        raise MeshError("polygons with fewer than three corners")
    found = []
    for width in np.unique(size):
        rows = _rows(offsets, corners, size == width, int(width))
        found.append(np.stack([rows[:, triangle(k)] for k in range(int(width) - 2)], axis=1).reshape(-1, 3))
    return np.concatenate(found) if found else np.empty((0, 3), dtype=np.int64)


def _rows(offsets: Longs, corners: Longs, chosen: Mask, width: int) -> Longs:
    return corners[offsets[:-1][chosen][:, None] + np.arange(width)]
