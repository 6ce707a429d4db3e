"""Arrays from an npz of unknown origin: checked before anything is unpacked, and never unpickled."""

from __future__ import annotations

import io
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
_NAME = re.compile(r"\w[\w.]{0,99}")  # no path
_SHOWN = 40  # characters of a name in a message
_DEFLATED = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
_HEADERS = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}  # by version of the format


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
    name = shown(member.filename, _SHOWN)
    with archive.open(member) as file:
        data = file.read(member.file_size + 1)
    if len(data) != member.file_size:
        raise ValueError(f"'{name}' is truncated")
    stream = io.BytesIO(data)
    try:
        shape, fortran, dtype = _HEADERS[npy.read_magic(stream)](stream)
    except Exception:  # numpy's readers raise anything for a damaged header
        raise ValueError(f"'{name}' is not an array, or has a damaged header") from None
    if dtype.hasobject:
        raise ValueError(f"'{name}' is pickled, and not read, since it could run any code")
    start = stream.tell()
    if min(shape, default=0) < 0 or not dtype.itemsize or math.prod(shape) * dtype.itemsize != len(data) - start:
        raise ValueError(f"'{name}' contains other bytes than its header says")
    flat = np.frombuffer(data, dtype=dtype, offset=start).copy()  # may be written to
    return flat.reshape(shape, order="F" if fortran else "C")
