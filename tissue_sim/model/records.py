"""Records with named, typed fields, which kernels and Python read alike: `settings.friction`, `count.faults`."""

from __future__ import annotations

from typing import Any, ClassVar, Self, get_type_hints

import numpy as np
from numpy.typing import NDArray

from tissue_sim.array_types import Longs

WORD = 8  # bytes
_KINDS = {int: np.int64, float: np.float64, bool: np.bool_}


class Record:
    """Base of records: what a class annotates as int, float or bool are the fields of its `dtype`, in whole words.

    An object is a NumPy record that views the words it was made on; writing to a field writes there.
    """

    dtype: ClassVar[np.dtype[Any]]

    def __init_subclass__(cls) -> None:
        """Work out the dtype."""
        hints = get_type_hints(cls)
        fields = [(name, _KINDS[hints[name]]) for name in cls.__annotations__]
        cls.dtype = _padded(np.dtype(fields, align=True))

    @classmethod
    def words(cls) -> int:
        """How many words a record takes."""
        return cls.dtype.itemsize // WORD

    @classmethod
    def rows(cls, words: Longs) -> Any:
        """The records (k,) in words (k * words(),)."""
        return words.view(cls.dtype).view(np.recarray)

    @classmethod
    def at(cls, words: Longs) -> Self:
        """The record in words (words(),)."""
        row: Self = cls.rows(words)[0]
        return row

    @classmethod
    def new(cls) -> Self:
        """A record of zeros on words of its own."""
        return cls.at(np.zeros(cls.words(), dtype=np.int64))


def array_of(value: Any) -> NDArray[Any]:
    """An array as it is; a record as an array without dimensions that views it."""
    if not isinstance(value, np.record):
        return np.asarray(value)
    around: Any = value.base
    made: NDArray[Any] = around.view(np.ndarray).reshape(())
    return made


def words_of(record: Any) -> Longs:
    """The words that a record views."""
    return array_of(record).reshape(1).view(np.int64)


def field_of(record: Any, name: str) -> memoryview:
    """Return a view (1,) of a record's field, for what is read or written all the time.

    By attribute NumPy takes 50 times as long.
    """
    return memoryview(array_of(record)[name].reshape(1))


def copy_of[R](record: R) -> R:
    """A record with the same fields on words of its own."""
    words = words_of(record).copy()
    made: R = words.view(record.dtype).view(np.recarray)[0]  # type: ignore[attr-defined]
    return made


def _padded(dtype: np.dtype[Any]) -> np.dtype[Any]:
    """The dtype, with room up to a whole number of words."""
    size = -(-dtype.itemsize // WORD) * WORD
    fields: dict[str, Any] = dict(dtype.fields or {})
    formats, offsets = zip(*(field[:2] for field in fields.values()), strict=True)
    return np.dtype({"names": list(fields), "formats": list(formats), "offsets": list(offsets), "itemsize": size})
