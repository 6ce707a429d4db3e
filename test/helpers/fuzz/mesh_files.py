"""Whole mesh files of every format, which hostile ones are made from: a ball as an ellipsoid."""

import base64
import json
import struct
from collections.abc import Callable
from functools import cache

import numpy as np
import trimesh
from numpy.typing import NDArray

from tissue_sim.organ.reporting.vtk_xml import tetrahedra


@cache
def _ball() -> tuple[NDArray, NDArray]:
    mesh = trimesh.creation.icosphere(2)
    return np.round(np.asarray(mesh.vertices) * [50.0, 30.0, 25.0], 4), np.asarray(mesh.faces, dtype=np.int64)


def _fan() -> tuple[NDArray, NDArray]:
    """The ball as tetrahedra that share its middle."""
    points, triangles = _ball()
    return np.vstack([points, [0.0, 0.0, 0.0]]), np.insert(triangles, 0, len(points), axis=1)


def _rows(array: NDArray, start: str = "") -> str:
    return "\n".join(start + " ".join(f"{value:g}" for value in row) for row in array) + "\n"


def _numbered(rows: NDArray, kind: str = "") -> str:
    """Rows behind their count, each with its number, what kind it is, and its values."""
    return f"{len(rows)}\n" + "".join(
        f"{k} {kind}{' '.join(f'{value:g}' for value in row)}\n" for k, row in enumerate(rows, 1)
    )


def exported(kind: str, **options: str) -> Callable[[], bytes]:
    """What writes the ball as trimesh does."""

    @cache
    def write() -> bytes:
        data = trimesh.Trimesh(*_ball(), process=False).export(file_type=kind, **options)
        return data.encode() if isinstance(data, str) else bytes(data)

    return write


@cache
def gltf() -> bytes:
    """In one file, with the buffer in the text."""
    data = exported("glb")()
    size = struct.unpack_from("<I", data, 12)[0]
    tree = json.loads(data[20 : 20 + size])
    tree["buffers"][0]["uri"] = "data:application/octet-stream;base64," + base64.b64encode(data[28 + size :]).decode()
    return json.dumps(tree).encode()


@cache
def vtk_text() -> bytes:
    points, triangles = _ball()
    n, t = len(points), len(triangles)
    return (
        f"# vtk DataFile Version 3.0\nball\nASCII\nDATASET POLYDATA\nPOINTS {n} float\n{_rows(points)}"
        f"POLYGONS {t} {4 * t}\n{_rows(triangles, '3 ')}"
    ).encode()


@cache
def vtk_binary() -> bytes:
    points, triangles = _ball()
    n, t = len(points), len(triangles)
    cells = np.hstack([np.full((t, 1), 3), triangles]).astype(">i4")
    head = f"# vtk DataFile Version 3.0\nball\nBINARY\nDATASET POLYDATA\nPOINTS {n} double\n"
    return (
        head.encode() + points.astype(">f8").tobytes() + f"\nPOLYGONS {t} {4 * t}\n".encode() + cells.tobytes() + b"\n"
    )


@cache
def vtk_5() -> bytes:
    points, triangles = _ball()
    t = len(triangles)
    offsets = " ".join(str(3 * k) for k in range(t + 1))
    return (
        f"# vtk DataFile Version 5.1\nball\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS {len(points)} double\n"
        f"{_rows(points)}CELLS {t + 1} {3 * t}\nOFFSETS vtktypeint64\n{offsets}\nCONNECTIVITY vtktypeint64\n"
        f"{_rows(triangles)}CELL_TYPES {t}\n" + "5\n" * t + f"POINT_DATA {len(points)}\nFIELD a 1\nb 1 1 float\n1\n"
    ).encode()


@cache
def vtp() -> bytes:
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


@cache
def vtu() -> bytes:
    points, cells = _fan()
    return tetrahedra(points, cells.astype(np.int32), {}, {})


@cache
def gmsh_1() -> bytes:
    points, triangles = _ball()
    return f"$NOD\n{_numbered(points)}$ENDNOD\n$ELM\n{_numbered(triangles + 1, '2 1 1 3 ')}$ENDELM\n".encode()


@cache
def gmsh_2() -> bytes:
    points, triangles = _ball()
    return (
        f"$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n{_numbered(points)}$EndNodes\n"
        f"$Elements\n{_numbered(triangles + 1, '2 2 1 1 ')}$EndElements\n"
    ).encode()


@cache
def gmsh_4() -> bytes:
    points, cells = _fan()
    n, t = len(points), len(cells)
    tags = "\n".join(str(k + 1) for k in range(n))
    elements = _numbered(cells + 1).partition("\n")[2]
    return (
        f"$MeshFormat\n4.1 0 8\n$EndMeshFormat\n$Nodes\n1 {n} 1 {n}\n3 1 0 {n}\n{tags}\n{_rows(points)}$EndNodes\n"
        f"$Elements\n1 {t} 1 {t}\n3 1 4 {t}\n{elements}$EndElements\n"
    ).encode()


@cache
def trian() -> bytes:
    points, triangles = _ball()
    return f"{len(points)}\n{_rows(points)}{len(triangles)}\n{_rows(triangles)}".encode()
