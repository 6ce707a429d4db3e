"""Numbers in a NIfTI's header that ITK never comes to an end with."""

from __future__ import annotations

import gzip
import struct
import zlib
from pathlib import Path
from typing import NamedTuple

import numpy as np

from tissue_sim.errors import UserError

_LARGEST = 1e9  # of a number in a transform
_GZIP = b"\x1f\x8b"


class _Layout(NamedTuple):
    """Of NIfTI 1 or 2: the header's length; the codes' type and where they are; the numbers' type, and where."""

    length: int
    code: str
    qform_code: int
    sform_code: int
    number: str
    quaternion: int  # with its offset, 6 numbers
    rows: int  # 12 numbers


_LAYOUTS = (_Layout(348, "h", 252, 254, "f4", 256, 280), _Layout(540, "i", 344, 348, "f8", 352, 400))


def check_nifti_header(path: Path) -> None:
    """Raise UserError where a transform that a NIfTI's header gives holds numbers that are not finite, or huge."""
    data = _head(path)
    for layout in _LAYOUTS:
        for order in "<>":
            if len(data) >= layout.length and struct.unpack_from(f"{order}i", data)[0] == layout.length:
                _check(path, data, layout, order)


def _check(path: Path, data: bytes, layout: _Layout, order: str) -> None:
    for code, at, count, name in (
        (layout.qform_code, layout.quaternion, 6, "qform"),
        (layout.sform_code, layout.rows, 12, "sform"),
    ):
        given = struct.unpack_from(f"{order}{layout.code}", data, code)[0] > 0
        numbers = np.frombuffer(data, f"{order}{layout.number}", count, at)
        if given and not np.all(np.abs(numbers) <= _LARGEST):
            raise UserError(f"{path} has a damaged header: its {name} holds numbers that are not finite, or huge")


def _head(path: Path) -> bytes:
    longest = max(layout.length for layout in _LAYOUTS)
    with path.open("rb") as file:
        data = file.read(longest)
        if data[:2] != _GZIP:
            return data
        file.seek(0)
        try:
            with gzip.open(file) as unpacked:
                return unpacked.read(longest)
        except (OSError, EOFError, zlib.error):  # ITK says what is wrong with it
            return b""
