"""Voxel files that an image's header names, and checks whether files can hold what a header claims."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from tissue_sim.array_types import Floats
from tissue_sim.errors import UserError, shown
from tissue_sim.organ.length_units import UNITS, metres

MOST_VOXELS = 1 << 29  # of a volume: 512 x 512 x 2048, which take 2 GB as they are worked with
LONGEST_HEADER = 1 << 20  # bytes of a text header
_DEFLATE = 1032  # bytes that a byte of gzip unpacks to at most
_SPARE = 1 << 16  # bytes for which that doesn't matter
_UNSPOKEN = ("", "?", "???", "none", "unknown")  # units that say none: millimetres, as everywhere in the field


class Header(NamedTuple):
    """Information of a header that ITK leaves out, or doesn't check.

    Attributes
    ----------
    beside : tuple[Path, ...]
        Voxel files next to the image.
    unit : float
        Millimetres in the header's unit of length.
    affine : Floats | None, shape (4, 4)
        Transform from voxel indices x, y, z to mm in LPS; None where ITK's is right.
    notes : tuple[str, ...]
        Remarks, one line each.
    least : int
        Bytes that the voxels' file has at least, unpacked; 0 where ITK checks that.
    """

    beside: tuple[Path, ...] = ()
    unit: float = 1.0
    affine: Floats | None = None
    notes: tuple[str, ...] = ()
    least: int = 0


def millimetres(path: Path, units: Sequence[str], field: str) -> float:
    """Return the millimetres in the unit of length that an image's header gives for its axes.

    Parameters
    ----------
    path : Path
        The file.
    units : Sequence[str]
        Unit of each axis, as the header spells it.
    field : str
        Field of the header, for messages.

    Returns
    -------
    float
        Millimetres in the unit; 1 where none is given.

    Raises
    ------
    UserError
        Where units differ between axes, or are not units of length.
    """
    said = {unit.strip() for unit in units} - set(_UNSPOKEN)
    if not said:
        return 1.0
    lengths = {metres(unit) for unit in said}
    (length, *others) = lengths
    if length is None or others:
        raise UserError(
            f"{path} has {field} {shown(', '.join(sorted(said)))}, which is not one length unit for all axes; write"
            f" one of {', '.join(UNITS)} there"
        )
    return length * 1e3


def unscaled(path: Path) -> str:
    """Return the note on an image whose header gives no voxel size.

    Parameters
    ----------
    path : Path
        File of the image.
    """
    return f"warning: {path.name} doesn't state the size of its voxels: 1 mm was assumed; write their size into it"


def data_file(path: Path, name: str) -> Path:
    """Return the voxel file that the header of an image names.

    Parameters
    ----------
    path : Path
        The image with the header.
    name : str
        Name in the header.

    Returns
    -------
    Path
        The file, which may be missing.

    Raises
    ------
    UserError
        Where it isn't a file in the image's folder.
    """
    if name.split(None, 1)[:1] == ["LIST"] or "%" in name:
        raise UserError(f"{path} has its voxels in several files; save it as one, as NRRD or MHA")
    inside = os.path.normpath(name)
    if not name or name == "-" or os.path.isabs(inside) or inside.split(os.sep)[0] == os.pardir:
        raise UserError(
            f"{path} has its voxels in '{shown(name)}', which is not in its folder; put that file next to it, and"
            " only its name into the header"
        )
    found = path.parent / inside
    if found.exists() and not found.is_file():
        raise UserError(f"{path} has its voxels in '{shown(name)}', which is not a file")
    return found


def check_room(path: Path, beside: Sequence[Path], size: Sequence[int], voxel: int) -> None:
    """Raise UserError where an image claims more voxels than a volume may have, or than its files can hold.

    To be called before memory for the voxels is requested.

    Parameters
    ----------
    path : Path
        The file.
    beside : Sequence[Path]
        Voxel files next to `path`.
    size : Sequence[int]
        Number of voxels along each axis.
    voxel : int
        Bytes of a voxel.

    Raises
    ------
    UserError
        Where the image claims too many voxels.
    """
    check_count(path, size)
    held = sum(os.path.getsize(file) for file in (path, *beside) if file.is_file())
    if math.prod(size) * voxel > _SPARE + held * _DEFLATE:
        raise UserError(
            f"{path} is damaged: its header states {_axes(size)} voxels, which its {held} bytes can't contain,"
            " compressed or not"
        )


def check_count(path: Path, size: Sequence[int]) -> None:
    """Check that a volume has no more voxels than can be processed.

    Parameters
    ----------
    path : Path
        File of the image.
    size : Sequence[int], voxels
        Its size along each axis.

    Raises
    ------
    UserError
        When it has more.
    """
    if math.prod(size) > MOST_VOXELS:
        raise UserError(
            f"{path} has {_axes(size)} voxels, more than {MOST_VOXELS / 1e6:.0f} million; crop it around the organ, or"
            " resample it"
        )


def _axes(size: Sequence[int]) -> str:
    return " x ".join(map(str, size))
