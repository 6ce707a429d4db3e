"""The file that an image's header names for its voxels, and whether files can hold what a header says."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from pathlib import Path

from tissue_sim.errors import UserError, shown

MOST_VOXELS = 1 << 29  # of a volume: 512 x 512 x 2048, which take 2 GB as they are worked with
LONGEST_HEADER = 1 << 20  # bytes of a text header
_DEFLATE = 1032  # bytes that a byte of gzip unpacks to at the most
_SPARE = 1 << 16  # bytes for which that doesn't matter


def data_file(path: Path, name: str) -> Path:
    """The file of voxels that the header of the image `path` names; raises UserError where it isn't in its folder."""
    if name.split(None, 1)[:1] == ["LIST"] or "%" in name:
        raise UserError(f"{path} has its voxels in several files; save it as one, as NRRD or MHA")
    inside = os.path.normpath(name)
    if not name or name == "-" or os.path.isabs(inside) or inside.split(os.sep)[0] == os.pardir:
        raise UserError(
            f"{path} has its voxels in '{shown(name)}', which is not in its folder; put that file beside it, and its"
            " name alone into the header"
        )
    found = path.parent / inside
    if found.exists() and not found.is_file():
        raise UserError(f"{path} has its voxels in '{shown(name)}', which is no file")
    return found


def check_room(path: Path, beside: Sequence[Path], size: Sequence[int], voxel: int) -> None:
    """Raise UserError where an image says that it holds more than a volume may, or than its files can.

    beside: files of voxels next to `path`. size: voxels along each axis, of so many bytes. To be called before room for
    them is asked for.
    """
    check_count(path, size)
    held = sum(os.path.getsize(file) for file in (path, *beside) if file.is_file())
    if math.prod(size) * voxel > _SPARE + held * _DEFLATE:
        raise UserError(
            f"{path} is damaged: its header says {_axes(size)} voxels, which its {held} bytes can't hold, packed or not"
        )


def check_count(path: Path, size: Sequence[int]) -> None:
    """Raise UserError where a volume has more voxels than are worked with."""
    if math.prod(size) > MOST_VOXELS:
        raise UserError(
            f"{path} has {_axes(size)} voxels, more than {MOST_VOXELS / 1e6:.0f} million; crop it around the organ, or"
            " resample it"
        )


def _axes(size: Sequence[int]) -> str:
    return " x ".join(map(str, size))
