"""Writers of VTK's XML files for ParaView and Slicer: points, lines and polygons (.vtp), and tetrahedra (.vtu).

Arrays are stored inline in base64, uncompressed, so nothing is rounded (VTK file formats, XML, "binary").
"""

from __future__ import annotations

import base64
import struct
import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from tissue_sim.array_types import Array

_TYPES = {"f8": "Float64", "f4": "Float32", "i4": "Int32", "i8": "Int64", "u1": "UInt8"}
_TETRAHEDRON = 10  # VTK's cell type


def polydata(
    positions: NDArray[np.float64],
    point_data: Mapping[str, Array],
    *,
    polygons: NDArray[np.int32] | None = None,
    lines: NDArray[np.int32] | None = None,
    comment: str = "",
) -> bytes:
    """Return a .vtp file.

    Parameters
    ----------
    positions : NDArray[np.float64], shape (n, 3)
        Points.
    point_data : Mapping[str, Array]
        Arrays of point data, shape (n,), by name.
    polygons : NDArray[np.int32] | None, shape (p, k), optional
        Point indices of polygons.
    lines : NDArray[np.int32] | None, shape (l, 2), optional
        Point indices of lines.
    comment : str, optional
        Comment in the file.
    """
    root, piece = _begun("PolyData", positions, {"PointData": point_data}, comment)
    for name, index in {"Verts": None, "Lines": lines, "Strips": None, "Polys": polygons}.items():
        piece.set(f"NumberOf{name}", str(0 if index is None else len(index)))
        if index is not None and len(index):
            _connect(ElementTree.SubElement(piece, name), index)
    return _ended(root)


def tetrahedra(
    positions: NDArray[np.float64],
    cells: NDArray[np.int32],
    point_data: Mapping[str, Array],
    cell_data: Mapping[str, Array],
    *,
    comment: str = "",
) -> bytes:
    """Return a .vtu file.

    Parameters
    ----------
    positions : NDArray[np.float64], shape (n, 3)
        Points.
    cells : NDArray[np.int32], shape (c, 4)
        Point indices of tetrahedra.
    point_data : Mapping[str, Array]
        Arrays of point data, shape (n,), by name.
    cell_data : Mapping[str, Array]
        Arrays of cell data, shape (c,), by name.
    comment : str, optional
        Comment in the file.
    """
    root, piece = _begun("UnstructuredGrid", positions, {"PointData": point_data, "CellData": cell_data}, comment)
    piece.set("NumberOfCells", str(len(cells)))
    group = ElementTree.SubElement(piece, "Cells")
    _connect(group, cells)
    _array(group, "types", np.full(len(cells), _TETRAHEDRON, dtype=np.uint8))
    return _ended(root)


def _begun(
    kind: str, positions: NDArray[np.float64], data: Mapping[str, Mapping[str, Array]], comment: str
) -> tuple[ElementTree.Element, ElementTree.Element]:
    """Return the file's root, and its piece with points and data."""
    root = ElementTree.Element("VTKFile", type=kind, version="1.0", byte_order="LittleEndian")
    root.set("header_type", "UInt64")
    if comment:
        root.append(ElementTree.Comment(f" {comment.replace('--', '- -')} "))
    piece = ElementTree.SubElement(ElementTree.SubElement(root, kind), "Piece")
    piece.set("NumberOfPoints", str(len(positions)))
    for name, arrays in data.items():
        group = ElementTree.SubElement(piece, name)
        for array, values in arrays.items():
            _array(group, array, values)
    _array(ElementTree.SubElement(piece, "Points"), "Points", positions, components=3)
    return root, piece


def _ended(root: ElementTree.Element) -> bytes:
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="utf-8", xml_declaration=True) + b"\n"


def _connect(parent: ElementTree.Element, index: NDArray[np.int32]) -> None:
    _array(parent, "connectivity", index.astype(np.int64))
    _array(parent, "offsets", np.arange(1, len(index) + 1, dtype=np.int64) * index.shape[1])


def _array(parent: ElementTree.Element, name: str, values: Array, components: int = 1) -> None:
    little = np.ascontiguousarray(values, dtype=values.dtype.newbyteorder("<"))
    kind = _TYPES[little.dtype.str[1:]]
    element = ElementTree.SubElement(parent, "DataArray", type=kind, Name=name, format="binary")
    if components > 1:
        element.set("NumberOfComponents", str(components))
    content = little.tobytes()
    element.text = base64.b64encode(struct.pack("<Q", len(content)) + content).decode()
