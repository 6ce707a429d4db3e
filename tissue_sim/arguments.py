"""Checks of arguments from scripts: numbers that must be finite, and items that are given by name or number."""

from __future__ import annotations

import difflib
import operator
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from tissue_sim.array_types import Floats
from tissue_sim.errors import UserError, shown


def floats_of(given: ArrayLike) -> Floats:
    """Return given numbers as an array of their shape, an empty one for anything else."""
    try:
        return np.asarray(given, dtype=np.float64)
    except (TypeError, ValueError):
        return np.zeros(0)


def finite(given: ArrayLike, count: int, name: str) -> Floats:
    """Return given numbers as an array (count,). Raises UserError, with their name, unless all are finite."""
    values = floats_of(given)
    if values.shape != (count,) or not np.all(np.isfinite(values)):
        wanted = "a finite number" if count == 1 else f"{count} finite numbers"
        raise UserError(f"{name} is {shown(repr(given))}; expected: {wanted}")
    return values


def number_of(given: int | str, names: Sequence[str], what: str) -> int:
    """Return the number of an item that is given by its name or its number; negative ones count from the last.

    Parameters
    ----------
    given
        The name or the number.
    names
        Of all that there are, in order.
    what
        What they are, for the message: `tool`.

    Raises
    ------
    UserError
        For one that isn't there.
    """
    if isinstance(given, str):
        if given in names:
            return names.index(given)
        near = difflib.get_close_matches(given, names, 1)
        hint = f"; did you mean '{near[0]}'?" if near else ""
    else:
        number, hint = operator.index(given), ""
        if -len(names) <= number < len(names):
            return number % len(names)
    there = f"choose {'one of ' if len(names) > 1 else ''}{', '.join(names)}" if names else "there are none"
    raise UserError(f"no {what} {shown(repr(given))}{hint or f'; {there}'}")
