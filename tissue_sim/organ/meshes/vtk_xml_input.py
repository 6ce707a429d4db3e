"""VTK's XML files of surfaces (.vtp) and of grids (.vtu), as ParaView, Slicer and VTK write them.

References
----------
VTK File Formats, "XML file formats"; the encodings as `vtkXMLWriter` has them. meshio 5.3 reads no .vtp.
"""

from __future__ import annotations

import base64
import lzma
import struct
import zlib
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from tissue_sim.array_types import Floats, Longs
from tissue_sim.errors import shown
from tissue_sim.organ.meshes.mesh_error import MeshError

_TYPES = {
    **{f"{sign}Int{8 * size}": f"{sign.lower() or 'i'}{size}" for sign in ("", "U") for size in (1, 2, 4, 8)},
    "Float32": "f4",
    "Float64": "f8",
    "String": "u1",
}
_COMPRESSORS: dict[str, Callable[[bytes, int], bytes]] = {
    "vtkZLibDataCompressor": lambda data, size: zlib.decompressobj().decompress(data, size + 1),
    "vtkLZMADataCompressor": lambda data, size: lzma.LZMADecompressor().decompress(data, size + 1),
}
_SECTIONS = {"Polys": "POLYGONS", "Strips": "TRIANGLE_STRIPS", "Cells": "CELLS"}  # as legacy files call them
_GROWTH = 1100  # of a block's size, at most, when it is decompressed: what zlib can reach


class Faces(NamedTuple):
    """Faces or cells of any number of corners: offsets (f + 1,) into their corners, one face after the other."""

    offsets: Longs
    corners: Longs


@dataclass
class Grid:
    """Positions (n, 3), faces or cells by the names of legacy files' sections, the kinds of CELLS, Slicer's SPACE."""

    positions: Floats = field(default_factory=lambda: np.empty((0, 3)))
    faces: dict[str, Faces] = field(default_factory=dict)
    kinds: Longs | None = None
    space: str = ""


def read(data: bytes) -> Grid:
    """Return what a .vtp or .vtu file holds. Raises ValueError for what can't be read."""
    reader = _Reader(data)
    found = Grid(space=reader.space())
    for piece in reader.pieces():
        _add(found, piece, reader)
    return found


def _add(found: Grid, piece: ElementTree.Element, reader: _Reader) -> None:
    """Add a piece to what has been found."""
    positions = reader.array(piece.find("Points/DataArray")).astype(np.float64).reshape(-1, 3)
    before = len(found.positions)
    found.positions = np.concatenate([found.positions, positions])
    for section, name in _SECTIONS.items():
        node = piece.find(section)
        if node is None or node.find("DataArray") is None:
            continue
        corners, ends = (_integers(reader.array(_named(node, part))) for part in ("connectivity", "offsets"))
        if np.any(np.diff(ends, prepend=0) < 0) or (ends[-1] if len(ends) else 0) != len(corners):
            raise MeshError("offsets that don't fit the corners of its cells")
        if len(corners) and not 0 <= corners.min() <= corners.max() < len(positions):
            raise MeshError("a triangle names a point that doesn't exist")
        old = found.faces.get(name, Faces(np.zeros(1, dtype=np.int64), np.empty(0, dtype=np.int64)))
        found.faces[name] = Faces(
            np.concatenate([old.offsets, ends + old.offsets[-1]]), np.concatenate([old.corners, corners + before])
        )
        if section == "Cells":
            kinds = _integers(reader.array(_named(node, "types")))
            if len(kinds) != len(ends):
                raise MeshError("another number of cells than of their types")
            found.kinds = kinds if found.kinds is None else np.concatenate([found.kinds, kinds])


def _named(node: ElementTree.Element, name: str) -> ElementTree.Element | None:
    return next((one for one in node.iter("DataArray") if one.get("Name") == name), None)


def _integers(values: NDArray[np.generic]) -> Longs:
    if values.dtype.kind not in "iu" or (values.dtype == np.uint64 and np.any(values > np.uint64(2**62))):
        raise MeshError("a number that can't be, where counts and indices are")
    return values.astype(np.int64)


class _Reader:
    """The arrays of one file: text, base64 or raw bytes, inline or appended, compressed or not."""

    def __init__(self, data: bytes) -> None:
        head, mark, tail = data.partition(b"<AppendedData")
        if b"<!DOCTYPE" in head or b"<!ENTITY" in head:  # entities may name files, or grow without end
            raise MeshError("a document type, which no VTK file has")
        if mark:
            opening, _, rest = tail.partition(b">")
            head += mark + opening + b"/></VTKFile>"
            self._appended = rest.partition(b"_")[2]
        try:
            self._root = ElementTree.fromstring(head)
        except ElementTree.ParseError as error:
            raise MeshError(f"no XML of VTK's: {error}") from None
        if self._root.tag != "VTKFile" or self._root.get("type") not in ("PolyData", "UnstructuredGrid"):
            raise MeshError(f"a VTK {shown(self._root.get('type', self._root.tag))}, no surface")
        self._order = ">" if self._root.get("byte_order") == "BigEndian" else "<"
        self._wide = "Q" if self._root.get("header_type") == "UInt64" else "I"
        self._compressor = self._root.get("compressor", "")
        if self._compressor and self._compressor not in _COMPRESSORS:
            raise MeshError(f"compressed by {shown(self._compressor)}: save it with zlib, or uncompressed")
        appended = self._root.find("AppendedData")
        self._is_raw = appended is not None and appended.get("encoding") == "raw"

    def pieces(self) -> list[ElementTree.Element]:
        """Return the pieces that the surface or grid is split into."""
        return self._root.findall("./*/Piece")

    def space(self) -> str:
        """Return the axes that Slicer notes in the field data, empty where it doesn't."""
        for node in self._root.findall("./*/FieldData/Array"):
            if node.get("Name") == "SPACE":
                return bytes(self.array(node).astype(np.uint8)).split(b"\0")[0].decode("ascii", "replace")
        return ""

    def array(self, node: ElementTree.Element | None) -> NDArray[np.generic]:
        """Return the numbers of a DataArray in a row."""
        if node is None:
            raise MeshError("an array that its cells or points need is missing")
        if node.get("type") not in _TYPES:
            raise MeshError(f"numbers of the type {shown(node.get('type', ''))}")
        kind = np.dtype(_TYPES[node.get("type", "")])
        how, text = node.get("format", "ascii"), node.text or ""
        if how == "ascii":
            return np.array(text.split(), dtype=kind)
        if how == "appended":
            start = int(node.get("offset", ""))
            source = self._appended[start:] if start >= 0 else b""
            found = self._block(source if self._is_raw else _Base64(source))
        else:
            found = self._block(_Base64(text.encode("ascii", "replace")))
        return np.frombuffer(found, self._order + kind.str[1:]).astype(kind)

    def _block(self, source: bytes | _Base64) -> bytes:
        """Return the bytes behind a header that says how many they are, or how many there are of each block."""
        size = struct.calcsize(self._wide)
        if not self._compressor:
            (count,) = self._numbers(source, 1)
            return source[size : size + count] if isinstance(source, bytes) else source.after(size, count)
        blocks, whole, last = self._numbers(source, 3)
        if not blocks:
            return b""
        if blocks > len(source):
            raise MeshError("more blocks than the file can hold")
        packed = self._numbers(source, 3 + blocks)[3:]
        start = (3 + blocks) * size
        rest = source[start:] if isinstance(source, bytes) else source.beyond(start)
        sizes = [whole] * (blocks - 1) + [last or whole]
        found, at = [], 0
        for length, wanted in zip(packed, sizes, strict=True):
            found.append(self._decompressed(rest[at : at + length], wanted))
            at += length
        return b"".join(found)

    def _decompressed(self, packed: bytes, wanted: int) -> bytes:
        if wanted > _GROWTH * max(len(packed), 1):
            raise MeshError("a block that would be larger than its bytes can make it")
        try:
            found = _COMPRESSORS[self._compressor](packed, wanted)
        except (zlib.error, lzma.LZMAError, EOFError):
            raise MeshError("a compressed block that is damaged") from None
        if len(found) != wanted:
            raise MeshError("a compressed block of another length than it says")
        return found

    def _numbers(self, source: bytes | _Base64, count: int) -> tuple[int, ...]:
        size = count * struct.calcsize(self._wide)
        head = source[:size] if isinstance(source, bytes) else source.first(size)
        if len(head) < size:
            raise MeshError("the file ends early")
        return struct.unpack(f"{self._order}{count}{self._wide}", head)


class _Base64:
    """Bytes in base64: a header that may be encoded for itself, and what follows it."""

    def __init__(self, text: bytes) -> None:
        self._text = b"".join(text.partition(b"<")[0].split())

    def __len__(self) -> int:
        return len(self._text)

    def first(self, count: int) -> bytes:
        """Return the first bytes."""
        return _decoded(self._text[: _characters(count)])[:count]

    def after(self, start: int, count: int) -> bytes:
        """Return bytes behind a header of `start`, which is part of the same code or has one of its own."""
        if b"=" in self._text[: _characters(start)]:
            return self.beyond(start)[:count]
        return _decoded(self._text[: _characters(start + count)])[start : start + count]

    def beyond(self, start: int) -> bytes:
        """Return all that follows a header with a code of its own."""
        rest = self._text[_characters(start) :]
        end = rest.find(b"=")
        return _decoded(rest if end < 0 else rest[: (end + 4) // 4 * 4])


def _characters(count: int) -> int:
    """Return the characters of base64 that so many bytes take."""
    return (count + 2) // 3 * 4


def _decoded(text: bytes) -> bytes:
    try:
        return base64.b64decode(text, validate=True)
    except ValueError:
        raise MeshError("a damaged array in base64") from None
