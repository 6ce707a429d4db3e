"""Hostile npz files: wrong headers, bombs, pickles, names that are paths."""

from __future__ import annotations

import io
import pickle
import struct
import zipfile
import zlib
from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from tissue_sim.bench.fuzz.files.mutations import BOMB, Rng, odd_count, of_bytes, some

PICKLED = "pickled"  # file that a pickle makes in the working folder when it is loaded
OUTSIDE = "../outside"


class _Payload:
    """Object that makes a file when it is unpickled."""

    def __reduce__(self) -> tuple[Any, ...]:
        return open, (PICKLED, "w")


def members(arrays: Mapping[str, NDArray[Any]]) -> dict[str, bytes]:
    """Return the files of an npz, by name.

    Parameters
    ----------
    arrays : Mapping[str, NDArray[Any]]
        Arrays by name.

    Returns
    -------
    dict[str, bytes]
        Contents by file name.
    """
    return {f"{name}.npy": _stored(array) for name, array in arrays.items()}


def _stored(array: NDArray[Any]) -> bytes:
    stream = io.BytesIO()
    npy.write_array(stream, np.asanyarray(array), allow_pickle=False)
    return stream.getvalue()


def packed(files: Mapping[str, bytes]) -> bytes:
    """Return files as a zip.

    Parameters
    ----------
    files : Mapping[str, bytes]
        Contents by name.

    Returns
    -------
    bytes
        The zip.
    """
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for name, data in files.items():
            archive.writestr(zipfile.ZipInfo(name), data)
    return stream.getvalue()


def of_zip(rng: Rng, files: dict[str, bytes]) -> tuple[bytes, str]:
    """Make a zip with a wrong structure.

    Parameters
    ----------
    rng : Rng
        Random numbers.
    files : dict[str, bytes]
        Contents by name.

    Returns
    -------
    tuple[bytes, str]
        The zip and a description.
    """
    way: Callable[[Rng, dict[str, bytes]], tuple[bytes, str]] = some(rng, _WAYS)
    return way(rng, dict(files))


def _left_out(rng: Rng, files: dict[str, bytes]) -> tuple[bytes, str]:
    name = some(rng, sorted(files))
    del files[name]
    return packed(files), f"{name} left out"


def _added(rng: Rng, files: dict[str, bytes]) -> tuple[bytes, str]:
    name = some(rng, ("further.npy", "header", "cell_nodes.npy.npy", "", "x" * 60_000))
    files[name] = files[some(rng, sorted(files))]
    return packed(files), f"{name[:20]} added"


def _doubled(rng: Rng, files: dict[str, bytes]) -> tuple[bytes, str]:
    name, other = some(rng, sorted(files)), some(rng, sorted(files))
    data = bytearray(packed({**files, "~" * len(name): files[other]}))
    return bytes(data.replace(b"~" * len(name), name.encode())), f"{name} there twice"


def _path(rng: Rng, files: dict[str, bytes]) -> tuple[bytes, str]:
    name = some(rng, sorted(files))
    files[some(rng, (f"{OUTSIDE}.npy", "/tmp/../etc/passwd", "..\\outside.npy", "a/../../outside.npy"))] = files.pop(
        name
    )
    return packed(files), f"{name} named by a path"


def _pickle(rng: Rng, files: dict[str, bytes]) -> tuple[bytes, str]:
    name = some(rng, sorted(files))
    stream = io.BytesIO()
    npy.write_array_header_1_0(stream, {"descr": "|O", "fortran_order": False, "shape": some(rng, ((), (1,), (2, 3)))})
    files[name] = some(rng, (stream.getvalue(), b"")) + pickle.dumps(_Payload())
    return packed(files), f"{name} pickled"


def _header(rng: Rng, files: dict[str, bytes]) -> tuple[bytes, str]:
    """Write an .npy header that contradicts its content."""
    name = some(rng, sorted(files))
    array = npy.read_array(io.BytesIO(files[name]), allow_pickle=False)
    shape: tuple[Any, ...] = tuple(odd_count(rng, n) for n in array.shape) or (odd_count(rng, 1),)
    descr: Any = array.dtype.str
    if rng.random() < 0.5:
        shape = array.shape
        odd = (
            "<f8",
            ">f8",
            "<i2",
            "|V0",
            "<U1000000",
            "<U0",
            "|S0",
            "|O",
            "x",
            [("a", "<f8"), ("a", "<f8")],
            None,
            "<f16",
        )
        descr = some(rng, odd)
    text = repr({"descr": descr, "fortran_order": bool(rng.random() < 0.3), "shape": shape})
    if rng.random() < 0.1:
        text = some(rng, ("{" * 5000, "__import__('os')", "{'descr': '<f8'}", text + " " * 70_000, "9" * 9000))
    body = files[name][10 + struct.unpack_from("<H", files[name], 8)[0] :]
    version = some(rng, (1, 2, 3, 9)) if rng.random() < 0.1 else 1
    size = struct.pack("<H" if version == 1 and len(text) < 65_000 else "<I", len(text) + 1)
    files[name] = b"\x93NUMPY" + bytes([version, 0]) + size + text.encode() + b"\n" + body
    return packed(files), f"{name} with the header {text[:60]}"


def bomb(rng: Rng, files: dict[str, bytes]) -> tuple[bytes, str]:
    """Make a zip in which one file, of 2 MB, unpacks to BOMB zeros, as its size says.

    Parameters
    ----------
    rng : Rng
        Random numbers.
    files : dict[str, bytes]
        Contents by name.

    Returns
    -------
    tuple[bytes, str]
        The zip and a description.
    """
    name = some(rng, sorted(files))
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
    return bytes(data), f"{name} unpacks to {whole} bytes"


@lru_cache(maxsize=1)
def _zeros_after(head: bytes) -> tuple[int, bytes, int]:
    """Return the length of `head` and BOMB zeros, the same deflated, and their CRC."""
    block = bytes(1 << 24)
    count = BOMB // len(block)
    deflate = zlib.compressobj(9, zlib.DEFLATED, -15)
    first = deflate.compress(head) + deflate.flush(zlib.Z_FULL_FLUSH)
    again = deflate.compress(block) + deflate.flush(zlib.Z_FULL_FLUSH)
    checksum = zlib.crc32(head)
    for _ in range(count):
        checksum = zlib.crc32(block, checksum)
    return len(head) + count * len(block), first + count * again + deflate.flush(), checksum


def _entries(data: bytearray) -> list[int]:
    """Return where the entries of the zip's directory begin."""
    return [at for at in range(len(data) - 4) if data[at : at + 4] == b"PK\x01\x02"]


def _directory(rng: Rng, files: dict[str, bytes]) -> tuple[bytes, str]:
    """Falsify the zip's own directory: sizes, offsets, methods, flags."""
    data = bytearray(packed(files))
    at = some(rng, _entries(data))
    field, size = some(rng, ((8, 2), (10, 2), (16, 4), (20, 4), (24, 4), (28, 2), (30, 2), (42, 4)))
    value = odd_count(rng, int.from_bytes(data[at + field : at + field + size], "little")) % 2 ** (8 * size)
    data[at + field : at + field + size] = value.to_bytes(size, "little")
    return bytes(data), f"{value} at byte {field} of an entry of the zip's directory"


def _bytes(rng: Rng, files: dict[str, bytes]) -> tuple[bytes, str]:
    return of_bytes(rng, packed(files))


def _member_bytes(rng: Rng, files: dict[str, bytes]) -> tuple[bytes, str]:
    name = some(rng, sorted(files))
    files[name], told = of_bytes(rng, files[name])
    return packed(files), f"{name}: {told}"


_WAYS = (
    *(_bytes, _bytes, _bytes, _directory, _directory, _header, _header, _header, _member_bytes, _member_bytes),
    *(_left_out, _added, _doubled, _path, _pickle, _pickle),
)
