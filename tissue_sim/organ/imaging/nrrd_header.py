"""What a NRRD's header says about the file of its voxels, and how they are written."""

from __future__ import annotations

from pathlib import Path

from tissue_sim.errors import UserError
from tissue_sim.organ.imaging.voxel_files import LONGEST_HEADER, data_file

_FIELDS = ("data file", "datafile")
_AS_TEXT = ("ascii", "text", "txt")  # ITK dies of one that breaks off


def check_nrrd_header(path: Path) -> tuple[Path, ...]:
    """The files of voxels beside a NRRD.

    Raises UserError where one isn't in its folder or holds text, and where the header has no end.
    """
    found: list[Path] = []
    left = LONGEST_HEADER
    with path.open("rb") as file:
        while left > 0:
            line = file.readline(left)
            left -= len(line)
            text = line.decode("latin-1").strip("\r\n")
            if not text:  # an empty line ends it, or the file does
                return tuple(one for one in found if one.is_file())
            field, colon, value = text.partition(":")
            name, value = " ".join(field.lower().split()), value.strip()  # readers have no regard to case
            if colon and name in _FIELDS:
                found.append(data_file(path, value))
            elif colon and name == "encoding" and value.lower() in _AS_TEXT:
                raise UserError(f"{path} has its voxels as text (encoding: {value}); save it as raw or gzip")
    raise UserError(f"{path} has a damaged header: no empty line ends it")
