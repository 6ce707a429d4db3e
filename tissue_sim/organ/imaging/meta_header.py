"""Numbers in a MetaImage's header (.mha, .mhd) that ITK takes at their word, and dies of."""

from __future__ import annotations

from pathlib import Path

from tissue_sim.errors import UserError, shown

_SUFFIXES = ".mha", ".mhd"
_LONGEST = 4096  # bytes of a header that are looked at
_MOST_AXES = 10
_MOST_VOXELS = 1 << 32


def check_meta_header(path: Path) -> None:
    """Raise UserError naming the line of a MetaImage's header that no image has; other files are left alone."""
    if path.suffix.lower() not in _SUFFIXES or not path.is_file():
        return
    with path.open("rb") as file:
        text = file.read(_LONGEST).decode("latin-1")
    for line in text.split("\n"):
        key, equals, value = (part.strip() for part in line.partition("="))
        if not equals:
            continue
        if key == "NDims" and not (value.isdecimal() and 1 <= int(value[:9]) <= _MOST_AXES):
            raise UserError(f"{path} has a damaged header: NDims = {shown(value)}, wanted 1 to {_MOST_AXES}")
        if key == "DimSize" and not _is_size(value.split()):
            raise UserError(f"{path} has a damaged header: DimSize = {shown(value)}, wanted positive numbers")
        if key == "ElementDataFile":  # the last one
            return


def _is_size(words: list[str]) -> bool:
    voxels = 1
    for word in words:
        if not word.isdecimal() or len(word) > 10:
            return False
        voxels *= int(word)
    return 0 < voxels <= _MOST_VOXELS
