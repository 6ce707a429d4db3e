"""Fields of DICOM files with another value, length or type."""

import struct
from collections.abc import Mapping

from hypothesis import note

from helpers.fuzz.mutations import Draw, chance, odd_count, of_bytes, some

_TYPES = (b"SQ", b"UN", b"OW", b"DS", b"US", b"FL", b"??", b"AT")
_NUMBERS = (0, 1, 3, 7, 8, 12, 16, 32, 64, 255, 32_767, 65_535)
_TEXTS = (
    *(b"nan\\nan\\nan", b"inf", b"1e400\\0\\0", b"0\\0\\0\\0\\0\\0", b"-1", b"99999999999"),
    *(b"1.2.840.10008.1.2.4.90", b""),
)


def changed_field(draw: Draw, data: bytes, tags: Mapping[str, tuple[int, int]]) -> bytes:
    """Change one of some fields, given by group and element, at one of its occurrences."""
    name = some(draw, sorted(tags))
    tag, places, at = struct.pack("<HH", *tags[name]), [], -1
    while (at := data.find(tag, at + 1)) >= 0:
        places.append(at)
    if not places:
        return of_bytes(draw, data)
    note(name)
    at, made = some(draw, places), bytearray(data)
    # Explicit VR: two letters, then two bytes of length; of OB and OW two zeros and four.
    wide = bytes(made[at + 4 : at + 6]) in (b"OB", b"OW", b"UN", b"SQ")
    start, size = (at + 12, 4) if wide else (at + 8, 2)
    length = int.from_bytes(made[start - size : start], "little")
    if chance(draw, 25):
        made[start - size : start] = (odd_count(draw, length) % 2 ** (8 * size)).to_bytes(size, "little")
    elif chance(draw, 15):
        made[at + 4 : at + 6] = some(draw, _TYPES)
    elif made[at + 4 : at + 6] == b"US" and start + 2 <= len(made):
        struct.pack_into("<H", made, start, some(draw, _NUMBERS))
    else:
        made[start : start + length] = some(draw, _TEXTS)[:length].ljust(length)
    return bytes(made)
