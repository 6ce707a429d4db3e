"""Checks of a MetaImage's header (.mha, .mhd) that ITK leaves out, although it crashes or opens other files."""

from __future__ import annotations

import math
import re
from pathlib import Path

from tissue_sim.errors import UserError, shown
from tissue_sim.organ.imaging.voxel_files import (
    LONGEST_HEADER,
    MOST_VOXELS,
    Header,
    data_file,
    millimetres,
    unscaled,
)

_LINE = re.compile(r"\s*(\w+)\s*[=:]\s*(.*)")
_MOST_AXES = 10
_LOCAL = ("local", "Local", "LOCAL")
_PACKED = ("", ".gz", ".Z")  # suffixes that ITK tries after the name
_SPACINGS = ("ElementSpacing", "ElementSize")  # ITK takes the second where the first is missing


def read_meta_header(path: Path) -> Header:
    """Read the voxel files beside a MetaImage and its unit of length, which ITK ignores.

    Parameters
    ----------
    path : Path
        The file.

    Raises
    ------
    UserError
        Where a line of the header is invalid, the data file isn't in the folder, or the unit is unknown.
    """
    with path.open("rb") as file:
        text = file.read(LONGEST_HEADER).decode("latin-1")
    packed, unit, scaled = "", 1.0, False
    for line in re.split(r"[\r\n]", text):
        found = _LINE.match(line)
        key, value = found.groups() if found else ("", "")
        value = value.strip()
        if key == "NDims" and not (value.isdecimal() and 1 <= int(value[:9]) <= _MOST_AXES):
            raise _damaged(path, key, value, f"1 to {_MOST_AXES}")
        if key == "DimSize" and not _is_size(value.split()):
            raise _damaged(path, key, value, "positive numbers")
        if key in _SPACINGS:
            scaled = True
            if not _are_lengths(value.split()):
                raise _damaged(path, key, value, "a number other than 0 for each axis")
        if key == "DistanceUnits":
            unit = millimetres(path, [value], key)
        if key == "CompressedDataSize":
            packed = value
        if key == "ElementDataFile":  # the last one
            files = () if value in _LOCAL else _beside(path, value)
            held = sum(one.stat().st_size for one in (path, *files))
            if packed and not _is_within(packed, held):
                raise _damaged(path, "CompressedDataSize", packed, f"at most the {held} bytes of the file")
            return Header(files, unit, notes=() if scaled else (unscaled(path),))
    raise UserError(f"{path} has a damaged header: it has no ElementDataFile")


def _beside(path: Path, name: str) -> tuple[Path, ...]:
    found = data_file(path, name)
    return tuple(one for suffix in _PACKED if (one := Path(f"{found}{suffix}")).is_file())


def _damaged(path: Path, key: str, value: str, wanted: str) -> UserError:
    return UserError(f"{path} has a damaged header: {key} = {shown(value)}, expected {wanted}")


def _is_size(words: list[str]) -> bool:
    if not words or not all(word.isdecimal() and len(word) <= 10 for word in words):
        return False
    return 0 < math.prod(map(int, words)) <= MOST_VOXELS


def _are_lengths(words: list[str]) -> bool:
    try:
        return all(math.isfinite(length) and length != 0.0 for length in map(float, words))
    except ValueError:
        return False


def _is_within(text: str, most: int) -> bool:
    try:
        return 0.0 <= float(text) <= most
    except ValueError:
        return False
