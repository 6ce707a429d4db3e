"""Hostile npz files: wrong headers, bombs, pickles, names that are paths."""

import io
import pickle
import struct
import zipfile
import zlib
from collections.abc import Mapping
from functools import cache
from typing import Any

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from helpers.fuzz.child import OUTSIDE
from helpers.fuzz.mutations import BOMB, Draw, chance, mutation, odd_count, of_bytes, some

Files = dict[str, bytes]


class _Payload:
    """Object that makes a file in the working folder when it is unpickled."""

    def __reduce__(self) -> tuple[Any, ...]:
        return open, ("pickled", "w")


def members(arrays: Mapping[str, NDArray]) -> Files:
    """The files of an npz, by name."""
    return {f"{name}.npy": _stored(array) for name, array in arrays.items()}


def _stored(array: NDArray) -> bytes:
    stream = io.BytesIO()
    npy.write_array(stream, np.asanyarray(array), allow_pickle=False)
    return stream.getvalue()


def packed(files: Files) -> bytes:
    """Files as a zip."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for name, data in files.items():
            archive.writestr(zipfile.ZipInfo(name), data)
    return stream.getvalue()


def of_zip(draw: Draw, files: Files) -> bytes:
    """A zip with a wrong structure."""
    return mutation(draw, _MUTATIONS)(draw, dict(files))


def _left_out(draw: Draw, files: Files) -> bytes:
    del files[some(draw, sorted(files))]
    return packed(files)


def _added(draw: Draw, files: Files) -> bytes:
    name = some(draw, ("further.npy", "header", "cell_nodes.npy.npy", "", "x" * 60_000))
    files[name] = files[some(draw, sorted(files))]
    return packed(files)


def _doubled(draw: Draw, files: Files) -> bytes:
    name, other = some(draw, sorted(files)), some(draw, sorted(files))
    data = packed({**files, "~" * len(name): files[other]})
    return data.replace(b"~" * len(name), name.encode())


def _named_by_a_path(draw: Draw, files: Files) -> bytes:
    path = some(draw, (f"../{OUTSIDE}.npy", "/tmp/../etc/passwd", "..\\outside.npy", "a/../../outside.npy"))
    files[path] = files.pop(some(draw, sorted(files)))
    return packed(files)


def _pickled(draw: Draw, files: Files) -> bytes:
    stream = io.BytesIO()
    shape = some(draw, ((), (1,), (2, 3)))
    npy.write_array_header_1_0(stream, {"descr": "|O", "fortran_order": False, "shape": shape})
    files[some(draw, sorted(files))] = some(draw, (stream.getvalue(), b"")) + pickle.dumps(_Payload())
    return packed(files)


_DESCRIPTIONS = (
    *("<f8", ">f8", "<i2", "|V0", "<U1000000", "<U0", "|S0", "|O", "x", "<f16"),
    *([("a", "<f8"), ("a", "<f8")], None),
)


def _header(draw: Draw, files: Files) -> bytes:
    """Write an .npy header that contradicts its content."""
    name = some(draw, sorted(files))
    array = npy.read_array(io.BytesIO(files[name]), allow_pickle=False)
    shape, descr = array.shape, array.dtype.str
    if chance(draw, 50):
        descr = some(draw, _DESCRIPTIONS)
    else:
        shape = tuple(odd_count(draw, n) for n in shape) or (odd_count(draw, 1),)
    text = repr({"descr": descr, "fortran_order": chance(draw, 30), "shape": shape})
    if chance(draw, 10):
        text = some(draw, ("{" * 5000, "__import__('os')", "{'descr': '<f8'}", text + " " * 70_000, "9" * 9000))
    body = files[name][10 + struct.unpack_from("<H", files[name], 8)[0] :]
    version = some(draw, (1, 2, 3, 9)) if chance(draw, 10) else 1
    size = struct.pack("<H" if version == 1 and len(text) < 65_000 else "<I", len(text) + 1)
    files[name] = b"\x93NUMPY" + bytes([version, 0]) + size + text.encode() + b"\n" + body
    return packed(files)


def bomb(draw: Draw, files: Files) -> bytes:
    """A zip in which one file, of 2 MB, unpacks to BOMB zeros, as its size says."""
    name = some(draw, sorted(files))
    head = io.BytesIO()
    npy.write_array_header_1_0(head, {"descr": "<f8", "fortran_order": False, "shape": ((BOMB - 128) // 24, 3)})
    whole, packed_whole, checksum = _zeros_after(head.getvalue())
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_STORED) as archive:
        for other, content in files.items():
            archive.writestr(zipfile.ZipInfo(other), packed_whole if other == name else content)
        local = archive.getinfo(name).header_offset
    data = bytearray(stream.getvalue())
    entry = next(at for at in _entries(data) if data[at + 46 :].startswith(name.encode()))
    for at in (local + 8, entry + 10):  # the method, and then checksum and sizes
        struct.pack_into("<H", data, at, zipfile.ZIP_DEFLATED)
        struct.pack_into("<III", data, at + 6, checksum, len(packed_whole), whole)
    return bytes(data)


@cache
def _zeros_after(head: bytes) -> tuple[int, bytes, int]:
    """The length of `head` and BOMB zeros, the same deflated, and their CRC."""
    block = bytes(1 << 24)
    count = BOMB // len(block)
    deflate = zlib.compressobj(9, zlib.DEFLATED, -15)
    first = deflate.compress(head) + deflate.flush(zlib.Z_FULL_FLUSH)
    again = deflate.compress(block) + deflate.flush(zlib.Z_FULL_FLUSH)
    checksum = zlib.crc32(head)
    for _ in range(count):
        checksum = zlib.crc32(block, checksum)
    return len(head) + count * len(block), first + count * again + deflate.flush(), checksum


def _entries(data: bytes | bytearray) -> list[int]:
    """Where the entries of the zip's directory begin."""
    return [at for at in range(len(data) - 4) if data[at : at + 4] == b"PK\x01\x02"]


def _directory(draw: Draw, files: Files) -> bytes:
    """Falsify the zip's own directory: sizes, offsets, methods, flags."""
    data = bytearray(packed(files))
    at = some(draw, _entries(data))
    field, size = some(draw, ((8, 2), (10, 2), (16, 4), (20, 4), (24, 4), (28, 2), (30, 2), (42, 4)))
    value = odd_count(draw, int.from_bytes(data[at + field : at + field + size], "little")) % 2 ** (8 * size)
    data[at + field : at + field + size] = value.to_bytes(size, "little")
    return bytes(data)


def _bytes_of_the_zip(draw: Draw, files: Files) -> bytes:
    return of_bytes(draw, packed(files))


def _bytes_of_a_member(draw: Draw, files: Files) -> bytes:
    name = some(draw, sorted(files))
    files[name] = of_bytes(draw, files[name])
    return packed(files)


_OFTEN = (_bytes_of_the_zip, _directory, _header, _bytes_of_a_member, _pickled)
_MUTATIONS = (*_OFTEN, *_OFTEN, _left_out, _added, _doubled, _named_by_a_path)
