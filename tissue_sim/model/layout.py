"""Named arrays and records laid one after the other in one array of words."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from tissue_sim.array_types import Longs
from tissue_sim.model.records import Record

# A field is a record, so many records of a kind, or a type of one word and a shape.
Field = type[Record] | tuple[type[Record], int] | tuple[Any, tuple[int, ...]]


def size_of(fields: Mapping[str, Field]) -> int:
    """Words that the fields take."""
    return sum(map(_words, fields.values()))


def carve(words: Longs, fields: Mapping[str, Field]) -> dict[str, Any]:
    """Views of the words (at least size_of(fields),) by the fields' names."""
    made: dict[str, Any] = {}
    start = 0
    for name, field in fields.items():
        part = words[start : start + _words(field)]
        start += len(part)
        if isinstance(field, type):
            made[name] = field.at(part)
        elif isinstance(field[1], int):
            made[name] = field[0].rows(part)
        else:
            made[name] = part.view(field[0]).reshape(field[1])
    return made


def _words(field: Field) -> int:
    if isinstance(field, type):
        return field.words()
    kind, many = field
    return kind.words() * many if isinstance(many, int) else math.prod(many)
