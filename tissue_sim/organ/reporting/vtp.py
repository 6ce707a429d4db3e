"""VTK's XML PolyData (.vtp): points, lines, polygons and point data, as ParaView and Slicer read them."""

from __future__ import annotations

import base64
import struct
import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

_TYPES = {"f8": "Float64", "f4": "Float32", "i4": "Int32", "i8": "Int64", "u1": "UInt8"}


def polydata(
    positions: NDArray[np.float64],
    point_data: Mapping[str, NDArray[Any]],
    *,
    polygons: NDArray[np.int32] | None = None,
    lines: NDArray[np.int32] | None = None,
    comment: str = "",
) -> bytes:
    """A .vtp file: positions (n, 3), arrays (n,) of point data by name, polygons (p, k) and lines (l, 2) of indices.

    Arrays are stored inline in base64, uncompressed, so nothing is rounded (VTK file formats, XML, "binary").
    """
    root = ElementTree.Element("VTKFile", type="PolyData", version="1.0", byte_order="LittleEndian")
    root.set("header_type", "UInt64")
    if comment:
        root.append(ElementTree.Comment(f" {comment.replace('--', '- -')} "))
    cells = {"Verts": None, "Lines": lines, "Strips": None, "Polys": polygons}
    piece = ElementTree.SubElement(ElementTree.SubElement(root, "PolyData"), "Piece")
    piece.set("NumberOfPoints", str(len(positions)))
    for name, index in cells.items():
        piece.set(f"NumberOf{name}", str(0 if index is None else len(index)))
    data = ElementTree.SubElement(piece, "PointData")
    for name, values in point_data.items():
        _array(data, name, values)
    _array(ElementTree.SubElement(piece, "Points"), "Points", positions, components=3)
    for name, index in cells.items():
        if index is not None and len(index):
            group = ElementTree.SubElement(piece, name)
            _array(group, "connectivity", index.astype(np.int64))
            _array(group, "offsets", np.arange(1, len(index) + 1, dtype=np.int64) * index.shape[1])
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="utf-8", xml_declaration=True) + b"\n"


def _array(parent: ElementTree.Element, name: str, values: NDArray[Any], components: int = 1) -> None:
    little = np.ascontiguousarray(values, dtype=values.dtype.newbyteorder("<"))
    kind = _TYPES[little.dtype.str[1:]]
    element = ElementTree.SubElement(parent, "DataArray", type=kind, Name=name, format="binary")
    if components > 1:
        element.set("NumberOfComponents", str(components))
    content = little.tobytes()
    element.text = base64.b64encode(struct.pack("<Q", len(content)) + content).decode()
