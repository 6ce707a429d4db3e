"""Words and numbers of a mesh file, as text or big-endian binary."""

from __future__ import annotations

import re

import numpy as np

from tissue_sim.array_types import Array, Floats
from tissue_sim.errors import shown
from tissue_sim.organ.meshes.mesh_error import MeshError

_WORD = re.compile(rb"\s*(\S+)")
_COUNT = re.compile(r"[+-]?[0-9]{1,18}")


class Words:
    """Cursor over a file of words and numbers, as text or (VTK) big-endian binary."""

    def __init__(self, data: bytes, at: int = 0) -> None:
        self.data, self.at, self.binary = data, at, False

    def line(self) -> str:
        """Return the rest of the line."""
        end = self.data.find(b"\n", self.at)
        end = len(self.data) if end < 0 else end
        text = self.data[self.at : end].decode("ascii", "replace").strip()
        self.at = end + 1
        return text

    def word(self) -> str:
        """Return the next word; empty at the end."""
        match = _WORD.match(self.data, self.at)
        if match is None:
            self.at = len(self.data)
            return ""
        self.at = match.end()
        return match[1].decode("ascii", "replace")

    def count(self) -> int:
        """Return the next word as a count."""
        word = self.word()
        if not word:
            raise MeshError("the file ends early")
        if not _COUNT.fullmatch(word):
            raise MeshError(f"{shown(word, 20)} where a count is expected")
        value = int(word)
        if value < 0:
            raise MeshError("a negative count")
        return value

    def numbers(self, count: int, kind: str) -> Array:
        """Return the next `count` numbers of a numpy type such as `f4`."""
        if self.binary:
            self.at += 1  # the line's end
            found = np.frombuffer(self.data, ">" + kind, count, self.at)
            self.at += found.nbytes
            return found.astype(kind)
        parts = self.data[self.at :].split(None, count)
        if len(parts) < count:
            raise MeshError("the file ends early")
        self.at = len(self.data) - (len(parts[count]) if len(parts) > count else 0)
        return cast(np.array(parts[:count], dtype="f8"), kind)

    def skip_strings(self, count: int) -> None:
        """Skip VTK strings: one per line, or in binary each after its length."""
        self.line()
        for _ in range(count):
            if self.binary:
                width = 1 << 3 - (self.data[self.at] >> 6)  # bytes of the length, whose first two bits say how many
                length = int.from_bytes(self.data[self.at : self.at + width], "big") & ((1 << 8 * width - 2) - 1)
                self.at += width + length
            else:
                self.line()


def cast(values: Floats, kind: str) -> Array:
    """Return numbers as a numpy type; those too large become infinity.

    Parameters
    ----------
    values : Floats
        The numbers.
    kind : str
        The type, such as `f4`.

    Raises
    ------
    ValueError
        When an integer is not one, or out of range.
    """
    if np.dtype(kind).kind in "iu":
        limits = np.iinfo(kind)
        if not np.all((values >= float(limits.min)) & (values < float(limits.max) + 1.0)):
            raise MeshError("an invalid number among counts and indices")
    with np.errstate(over="ignore"):
        return values.astype(kind)
