"""A reader of .vtp and .vtu files as the VTK file formats describe them."""

import base64
import struct
import xml.etree.ElementTree as ElementTree

import numpy as np


def read_vtk(path, kind="PolyData"):
    """Arrays of a .vtp or .vtu file by their place in it, decoded as the VTK file format says."""
    root = ElementTree.parse(path).getroot()
    assert root.attrib["type"] == kind
    assert root.attrib["header_type"] == "UInt64"
    assert root.attrib["byte_order"] == "LittleEndian"
    piece = root.find(f"{kind}/Piece")
    kinds = {"Float64": "<f8", "Int32": "<i4", "Int64": "<i8", "UInt8": "<u1"}
    found = {}
    for group in piece:
        for array in group:
            raw = base64.b64decode(array.text)
            assert struct.unpack("<Q", raw[:8]) == (len(raw) - 8,)
            values = np.frombuffer(raw[8:], kinds[array.attrib["type"]])
            width = int(array.attrib.get("NumberOfComponents", "1"))
            found[f"{group.tag}/{array.attrib['Name']}"] = values.reshape(-1, width) if width > 1 else values
    return found, piece.attrib
