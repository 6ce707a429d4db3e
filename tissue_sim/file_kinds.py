"""Recognition of a file's kind by its first bytes, for messages about files of the wrong kind."""

from __future__ import annotations

import zlib
from pathlib import Path

MESH, IMAGE, ORGAN = "mesh", "image", "organ file"  # what may be wanted

_HEAD = 512  # bytes that are looked at
_PIECE = 1 << 20  # bytes that are unpacked at a time
_PACKED = (b"\x1f\x8b", b"\x78\x01", b"\x78\x5e", b"\x78\x9c", b"\x78\xda")  # beginnings of gzip and zlib
# Place and bytes by which a file is known, what it is, and what it can be used as.
_KINDS = (
    (0, b"\x89PNG\r\n\x1a\n", "a PNG picture", ""),
    (0, b"\xff\xd8\xff", "a JPEG picture", ""),
    (0, b"GIF8", "a GIF picture", ""),
    (0, b"%PDF", "a PDF document", ""),
    (0, b"<!DOCTYPE html", "a web page", ""),
    (0, b"<html", "a web page", ""),
    (0, b"version https://git-lfs", "a pointer of Git LFS, which 'git lfs pull' replaces by the file", ""),
    (0, b"SQLite format 3", "a database", ""),
    (0, b"\x89HDF\r\n\x1a\n", "an HDF5 file", ""),
    (0, b"\x89MCAP0\r\n", "a file of a bag", ""),
    (0, b"\x93NUMPY", "an array of NumPy (.npy)", ""),
    (0, b"PK\x03\x04", "a zip archive, as an organ file is", ORGAN),
    (0, b"ply\n", "a mesh (PLY)", MESH),
    (0, b"glTF", "a mesh (GLB)", MESH),
    (0, b"NRRD", "an image (NRRD)", IMAGE),
    (0, b"ObjectType", "an image (MetaImage)", IMAGE),
    (344, b"n+1\0", "an image (NIfTI)", IMAGE),
    (128, b"DICM", "a DICOM file", IMAGE),
    (0, b"\x1f\x8b", "compressed by gzip, as images may be", IMAGE),
)


def wrong_kind(path: Path, wanted: str) -> str:
    """Return what a file holds instead of what is wanted, such as `is empty` or `is a PNG picture`.

    Parameters
    ----------
    path : Path
        The file.
    wanted : str
        MESH, IMAGE or ORGAN.

    Returns
    -------
    str
        The end of a sentence about the file; empty where its first bytes show nothing else.

    Raises
    ------
    OSError
        Where the file can't be read.
    """
    with path.open("rb") as stream:
        head = stream.read(_HEAD)
    if not head:
        return "is empty"
    found = ((what, use) for at, known, what, use in _KINDS if head[at : at + len(known)] == known)
    what, use = next(found, ("", wanted))
    return "" if use == wanted else f"is {what}"


def unpacked_size(path: Path, begin: int = 0) -> int | None:
    """Return the size of a file's content, unpacked where it is compressed by gzip or zlib.

    Parameters
    ----------
    path : Path
        The file.
    begin : int, bytes, optional
        Where the content begins.

    Returns
    -------
    int | None, bytes
        The size; None where compressed data is cut off, or doesn't have the checksum that it states.

    Raises
    ------
    OSError
        Where the file can't be read.
    """
    with path.open("rb") as stream:
        stream.seek(begin)
        if not stream.read(2).startswith(_PACKED):
            return path.stat().st_size - begin
        stream.seek(begin)
        size, data = 0, b""
        unpacker = zlib.decompressobj(wbits=47)  # of either kind
        try:
            while data or (data := stream.read(_PIECE)):
                size += len(unpacker.decompress(data, _PIECE))  # a piece at a time: a few bytes may unpack to gigabytes
                data = unpacker.unconsumed_tail
                if unpacker.eof:
                    data = unpacker.unused_data
                    if not data.startswith(_PACKED):
                        return size
                    unpacker = zlib.decompressobj(wbits=47)  # gzip's parts follow each other
        except zlib.error:
            return None
    return None
