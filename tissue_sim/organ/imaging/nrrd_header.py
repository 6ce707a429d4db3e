"""What a NRRD's header says about its voxel file, its encoding, and its unit of length."""

from __future__ import annotations

import re
from pathlib import Path

from tissue_sim.errors import UserError
from tissue_sim.organ.imaging.voxel_files import LONGEST_HEADER, Header, data_file, millimetres, unscaled

_FIELDS = ("data file", "datafile")
_AS_TEXT = ("ascii", "text", "txt")  # ITK dies of one that breaks off


def read_nrrd_header(path: Path) -> Header:
    """Read the voxel files beside a NRRD and its unit of length, which ITK ignores.

    Parameters
    ----------
    path : Path
        The file.

    Raises
    ------
    UserError
        Where a file isn't in the folder or holds text, where the unit is unknown, and where the header has no end.
    """
    beside: list[Path] = []
    fields: dict[str, str] = {}
    left = LONGEST_HEADER
    with path.open("rb") as file:
        while left > 0:
            line = file.readline(left)
            left -= len(line)
            text = line.decode("utf-8", "replace").strip("\r\n")
            if not text:  # an empty line ends it, or the file does
                unit, notes = _unit(path, fields)
                return Header(tuple(one for one in beside if one.is_file()), unit, notes=notes)
            field, colon, value = text.partition(":")
            name, value = " ".join(field.lower().split()), value.strip()  # readers ignore case
            if not colon or value.startswith("="):  # a comment, or a key of the user's own
                continue
            fields[name] = value
            if name in _FIELDS:
                beside.append(data_file(path, value))
            elif name == "encoding" and value.lower() in _AS_TEXT:
                raise UserError(f"{path} has its voxels as text (encoding: {value}); save it as raw or gzip")
    raise UserError(f"{path} has a damaged header: no empty line ends it")


def _unit(path: Path, fields: dict[str, str]) -> tuple[float, tuple[str, ...]]:
    """Return the mm in the header's unit of length, and remarks on it."""
    if "space directions" in fields:
        field = "space units"
    elif re.search(r"\d", fields.get("spacings", "")):
        field = "units"
    else:
        return 1.0, (unscaled(path),)
    return millimetres(path, re.findall(r'"([^"]*)"', fields.get(field, "")), field), ()
