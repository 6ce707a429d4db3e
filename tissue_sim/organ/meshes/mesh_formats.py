"""Triangles from mesh files: trimesh's formats, meshio's Gmsh, and readers for Gmsh 1, VTK and SOFA's .trian.

No library that is small reads the last three as they occur: meshio 5.3 takes neither POLYDATA nor Gmsh 1, and VTK
itself weighs 100 MB.
"""

from __future__ import annotations

import logging
import re
from collections.abc import Callable
from functools import partial
from io import BytesIO
from pathlib import Path

import numpy as np
import trimesh
from trimesh.parent import Geometry

from tissue_sim.array_types import Floats, Longs
from tissue_sim.memory import limited
from tissue_sim.organ.imaging.itk_output import silenced
from tissue_sim.organ.meshes.mesh_error import MeshError
from tissue_sim.organ.meshes.mesh_file import ROOM, ROOM_PER_BYTE, MeshFile, Piece, surface_of_cells
from tissue_sim.organ.meshes.vtk_input import read_vtk, read_vtk_xml
from tissue_sim.organ.meshes.words import Words, cast

logging.getLogger("trimesh").addHandler(logging.NullHandler())  # otherwise trimesh prints what it tolerates

_TRIMESH = (".glb", ".gltf", ".obj", ".off", ".ply", ".stl")
# glTF 2.0, 3.4: +Y up, +Z forward, -X right; so these rows take it to LPS (x left, y back, z up).
GLTF_TO_LPS = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])


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


def _load_trimesh(source: Path) -> Geometry:
    load = partial(trimesh.load, process=False, maintain_order=True)
    if source.suffix.lower() != ".glb":
        return load(source)
    # Read from memory: from a file, trimesh would request as much memory as a chunk claims to hold.
    resolver = trimesh.resolvers.FilePathResolver(str(source))
    return load(BytesIO(source.read_bytes()), file_type="glb", resolver=resolver)


def _pieces(loaded: Geometry, suffix: str) -> MeshFile:
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


def _piece(mesh: Geometry, name: str, transform: Floats) -> Piece:
    if not isinstance(mesh, trimesh.Trimesh):
        raise MeshError("no triangles")
    positions = np.array(mesh.vertices, dtype=np.float64)
    if not np.array_equal(transform, np.eye(4)):
        positions = positions @ transform[:3, :3].T + transform[:3, 3]
    triangles = np.array(mesh.faces, dtype=np.int64)
    if np.linalg.det(transform[:3, :3]) < 0.0:
        triangles = triangles[:, ::-1]
    return Piece(name, positions, triangles)


def _read_trian(source: Path) -> MeshFile:
    """Read SOFA's .trian: number of points, coordinates, number of triangles, corners (and neighbours)."""
    words = Words(source.read_bytes())
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


def _read_gmsh(source: Path) -> MeshFile:
    """Read Gmsh's .msh: text of version 1, text and binary of versions 2 and 4."""
    text = source.read_bytes()
    if text.lstrip()[:4].upper() == b"$NOD":
        positions, cells = _gmsh_1(text)
    else:
        from meshio import gmsh

        try:
            with silenced(), np.errstate(all="ignore"), limited(ROOM + ROOM_PER_BYTE * len(text)):
                mesh = gmsh.read(source)
        except MemoryError:
            raise MeshError("a count larger than the file can contain") from None
        positions, cells = np.asarray(mesh.points, dtype=np.float64), mesh.cells_dict
    return surface_of_cells(positions, cells)


def _gmsh_1(text: bytes) -> tuple[Floats, dict[str, Longs]]:
    """Return points, and corner indices by kind of element, of lines `number type region region count nodes`."""
    sections = {m[1].upper(): m[2] for m in re.finditer(rb"\$(\w+)\s(.*?)\$End\1", text, re.DOTALL | re.IGNORECASE)}
    if not {b"NOD", b"ELM"} <= sections.keys():
        raise MeshError("no nodes and elements")
    words = sections[b"NOD"].split()
    table = np.array(words[1 : 1 + 4 * int(words[0])], dtype=np.float64).reshape(int(words[0]), 4)
    place = {int(tag): k for k, tag in enumerate(cast(table[:, 0], "i8"))}
    found: dict[str, list[list[int]]] = {}
    numbers = [int(word) for word in sections[b"ELM"].split()]
    at = 1
    for _ in range(numbers[0]):
        kind, count = _GMSH_KINDS.get(numbers[at + 1], ""), numbers[at + 4]
        nodes = numbers[at + 5 : at + 5 + count]
        if not all(node in place for node in nodes):
            raise MeshError("an element names a node that doesn't exist")
        found.setdefault(kind, []).append([place[node] for node in nodes])
        at += 5 + count
    return table[:, 1:], {kind: np.array(rows, dtype=np.int64) for kind, rows in found.items() if kind}


_READERS: dict[str, Callable[[Path], MeshFile]] = {
    **dict.fromkeys(_TRIMESH, _read_trimesh),
    ".msh": _read_gmsh,
    ".trian": _read_trian,
    ".vtk": read_vtk,
    ".vtp": read_vtk_xml,
    ".vtu": read_vtk_xml,
}
FORMATS = tuple(sorted(_READERS))
