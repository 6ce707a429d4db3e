"""Arrays from an npz of unknown origin: checked before anything is unpacked, and never unpickled."""

from __future__ import annotations

import ast
import math
import os
import re
import struct
import zipfile
import zlib
from typing import IO

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from tissue_sim.errors import shown

MOST_BYTES = 1 << 30  # of all arrays at most; an organ of a million nodes takes about that
MOST_TIMES = 200  # largest ratio of an array's size to its packed size; for real data it is 20
_SMALL = 1 << 26  # bytes up to which the ratio doesn't matter
_LONGEST_HEADER = 10_000  # characters, as numpy has it
_NAME = re.compile(r"\w[\w.]{0,99}")  # no path
_SHOWN = 40  # characters of a name in a message
_DEFLATED = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)


def read_npz(source: str | os.PathLike[str] | IO[bytes]) -> dict[str, NDArray]:
    """Return the arrays of an npz by name.

    Parameters
    ----------
    source : str | os.PathLike[str] | IO[bytes]
        The file, or its bytes.

    Returns
    -------
    dict[str, NDArray]
        Arrays by name.

    Raises
    ------
    ValueError
        With a short reason, where it is damaged, holds anything but arrays of numbers or text, or would take more than
        MOST_BYTES.
    OSError
        Where it can't be read.
    """
    try:
        with zipfile.ZipFile(source) as archive:
            members = archive.infolist()
            _check(members)
            return {member.filename.removesuffix(".npy"): _array(archive, member) for member in members}
    except (zipfile.BadZipFile, zlib.error, EOFError, struct.error, OverflowError) as error:
        raise ValueError(f"not a complete npz file: {error}") from None
    except (NotImplementedError, RuntimeError) as error:  # encrypted, or packed in another way
        raise ValueError(f"an npz file that numpy doesn't write: {error}") from None


def _check(members: list[zipfile.ZipInfo]) -> None:
    """Check names and sizes before anything is unpacked."""
    names = [member.filename for member in members]
    if len(set(names)) < len(names):
        raise ValueError("an array is contained twice")
    for member in members:
        if not _NAME.fullmatch(member.filename) or member.compress_type not in _DEFLATED:
            raise ValueError(f"'{shown(member.filename, _SHOWN)}' is not an array")
        if member.file_size > max(_SMALL, MOST_TIMES * member.compress_size):
            raise ValueError(f"'{shown(member.filename, _SHOWN)}' unpacks to more than {MOST_TIMES} times its size")
    unpacked = sum(member.file_size for member in members)
    if unpacked > MOST_BYTES:
        raise ValueError(f"its arrays take {unpacked / 2**30:.3g} GB, more than {MOST_BYTES / 2**30:g}")


def _array(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> NDArray:
    with archive.open(member) as stream:
        data = stream.read(member.file_size + 1)
    if len(data) != member.file_size:
        raise ValueError(f"'{shown(member.filename, _SHOWN)}' is truncated")
    dtype, fortran, shape, start = _header(data, member.filename)
    if math.prod(shape) * dtype.itemsize != len(data) - start:
        raise ValueError(f"'{shown(member.filename, _SHOWN)}' contains other bytes than its header says")
    flat = np.frombuffer(data, dtype=dtype, offset=start).copy()  # may be written to
    return flat.reshape(shape[::-1]).transpose() if fortran else flat.reshape(shape)


def _header(data: bytes, name: str) -> tuple[np.dtype, bool, tuple[int, ...], int]:
    """Return type, order and shape, and where the numbers begin."""
    if data[:6] != npy.MAGIC_PREFIX or data[6:7] not in (b"\1", b"\2", b"\3"):
        raise ValueError(f"'{shown(name, _SHOWN)}' is not an array, or is pickled")
    wide = data[6] > 1
    start = 12 if wide else 10
    end = start + struct.unpack_from("<I" if wide else "<H", data, 8)[0]
    if end - start > _LONGEST_HEADER or end > len(data):
        raise ValueError(f"'{shown(name, _SHOWN)}' has a damaged header")
    try:
        told = ast.literal_eval(data[start:end].decode("latin1").strip())
        shape = told["shape"]
        dtype = npy.descr_to_dtype(told["descr"])
        fortran = bool(told["fortran_order"])
    except (ValueError, SyntaxError, TypeError, KeyError, AttributeError, IndexError, RecursionError, MemoryError):
        raise ValueError(f"'{shown(name, _SHOWN)}' has a damaged header") from None
    if dtype.hasobject:
        raise ValueError(f"'{shown(name, _SHOWN)}' is pickled, and not read, since it could run any code")
    if not isinstance(shape, tuple) or not all(type(n) is int and n >= 0 for n in shape) or not dtype.itemsize:
        raise ValueError(f"'{shown(name, _SHOWN)}' has a damaged header")
    return dtype, fortran, shape, end
