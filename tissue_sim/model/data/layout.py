"""Layout of named arrays and records, one after the other in one array of words."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from tissue_sim.array_types import Longs
from tissue_sim.model.data.records import Record

# A field is a record, a number of records of a kind, or a type of one word and a shape.
Field = type[Record] | tuple[type[Record], int] | tuple[Any, tuple[int, ...]]


def size_of(fields: Mapping[str, Field]) -> int:
    """Return the number of words that the fields take.

    Parameters
    ----------
    fields : Mapping[str, Field]
        Fields by name.
    """
    return sum(map(_words, fields.values()))


def carve(words: Longs, fields: Mapping[str, Field]) -> dict[str, Any]:
    """Return views of words by the fields' names.

    Parameters
    ----------
    words : Longs, shape (size_of(fields),) or longer
        Memory.
    fields : Mapping[str, Field]
        Fields by name.

    Returns
    -------
    dict[str, Any]
        Arrays and records by name.
    """
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
