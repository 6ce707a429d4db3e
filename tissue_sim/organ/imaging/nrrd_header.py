"""What a NRRD's header says about the file of its voxels."""

from __future__ import annotations

from pathlib import Path

from tissue_sim.errors import UserError
from tissue_sim.organ.imaging.voxel_files import LONGEST_HEADER, data_file

_FIELDS = ("data file", "datafile")


def check_nrrd_header(path: Path) -> tuple[Path, ...]:
    """The files of voxels beside a NRRD; raises UserError where one isn't in its folder, or the header has no end."""
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
            # What the reader compares it with has no regard to case.
            if colon and " ".join(field.lower().split()) in _FIELDS:
                found.append(data_file(path, value.strip()))
    raise UserError(f"{path} has a damaged header: no empty line ends it")
