"""Records with named, typed fields, which both kernels and Python read: `settings.friction`, `count.faults`."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Self, get_args, get_type_hints

import numpy as np
from numpy.typing import NDArray

from tissue_sim.array_types import Floats, Longs

WORD = 8  # bytes
_KINDS: dict[Any, Any] = {int: np.int64, float: np.float64, bool: np.bool_, Longs: np.int64, Floats: np.float64}


Vector = Annotated[Floats, (3,)]
Records = np.recarray[Any, np.dtype[np.record]]  # an array of records: its fields are arrays


class Record:
    """Base of records: annotations of a class are the fields of its `dtype`, in whole words.

    A field is an int, float or bool, or an array with a fixed shape, such as `Vector`. An object is a NumPy record that
    views the words from which it was made; writing to a field changes these.
    """

    dtype: ClassVar[np.dtype[Any]]

    def __init_subclass__(cls) -> None:
        """Compute the dtype."""
        hints = get_type_hints(cls, include_extras=True)
        fields = [(name, *_field(hints[name])) for name in cls.__annotations__]
        cls.dtype = _padded(np.dtype(fields, align=True))

    @classmethod
    def words(cls) -> int:
        """Return the number of words of a record."""
        return cls.dtype.itemsize // WORD

    @classmethod
    def rows(cls, words: Longs) -> Records:
        """Return the records in words.

        Parameters
        ----------
        words : Longs, shape (k * words(),)
            Memory of the records.

        Returns
        -------
        Records
            shape (k,)
        """
        return words.view(cls.dtype).view(np.recarray)

    @classmethod
    def at(cls, words: Longs) -> Self:
        """Return the record in words.

        Parameters
        ----------
        words : Longs, shape (words(),)
            Memory of the record.
        """
        row: Self = cls.rows(words)[0]
        return row

    @classmethod
    def new(cls) -> Self:
        """Return a record of zeros in memory of its own."""
        return cls.at(np.zeros(cls.words(), dtype=np.int64))


def array_of(value: Any) -> NDArray[Any]:
    """Return an array unchanged, or a record as an array without dimensions that views it.

    Parameters
    ----------
    value : Any
        Array or record.

    Returns
    -------
    NDArray[Any]
        The array.
    """
    if not isinstance(value, np.record):
        return np.asarray(value)
    around: Any = value.base
    made: NDArray[Any] = around.view(np.ndarray).reshape(())
    return made


def words_of(record: Any) -> Longs:
    """Return the words that a record views.

    Parameters
    ----------
    record : Any
        The record.
    """
    return array_of(record).reshape(1).view(np.int64)


def field_of(record: Any, name: str) -> memoryview:
    """Return a view of a record's field, for frequent access: by attribute NumPy takes 50 times as long.

    Parameters
    ----------
    record : Any
        The record.
    name : str
        Name of the field.

    Returns
    -------
    memoryview, shape (1,)
        The view.
    """
    return memoryview(array_of(record)[name].reshape(1))


def copy_of[R](record: R) -> R:
    """Return a record with the same fields in memory of its own.

    Parameters
    ----------
    record : R
        The record.
    """
    words = words_of(record).copy()
    made: R = words.view(record.dtype).view(np.recarray)[0]  # type: ignore[attr-defined]
    return made


def _field(hint: Any) -> tuple[Any, tuple[int, ...]]:
    """Return the NumPy type and the shape of an annotation's field."""
    kind, shape = get_args(hint) or (hint, ())
    return _KINDS[kind], shape


def _padded(dtype: np.dtype[Any]) -> np.dtype[Any]:
    """Return the dtype, padded to a whole number of words."""
    size = -(-dtype.itemsize // WORD) * WORD
    fields: dict[str, Any] = dict(dtype.fields or {})
    formats, offsets = zip(*(field[:2] for field in fields.values()), strict=True)
    return np.dtype({"names": list(fields), "formats": list(formats), "offsets": list(offsets), "itemsize": size})
