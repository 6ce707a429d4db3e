"""Selection of the surface nodes of an organ that are held."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from tissue_sim.array_types import Array, Floats, Ints
from tissue_sim.errors import UserError

_FIXED = re.compile(r"([xyz])\s*([<>])\s*([0-9]*\.?[0-9]+)")


def select_fixed(choice: str | ArrayLike, positions: Floats) -> Ints:
    """Return the indices of the surface nodes that are held.

    Parameters
    ----------
    choice
        `none`; `z<0.1` for the lowest tenth of the extent along z (axes x, y, z; < or >); a .npy file of indices; or
        the indices (k,).
    positions
        (n, 3) m, of the surface nodes.

    Raises
    ------
    UserError
        For a choice that is not one of these, or names nodes that aren't there.
    """
    if not isinstance(choice, str):
        return _indices(np.asarray(choice), len(positions), "fixed")
    text = choice.strip()
    if text.lower() == "none":
        return np.empty(0, dtype=np.int32)
    if text.endswith(".npy"):
        return _fixed_from_file(Path(text), len(positions))
    match = _FIXED.fullmatch(text)
    if match is None:
        raise UserError(
            f"--fixed '{choice}' is not understood; use 'z<0.1' (axis, < or >, fraction), a .npy file or none"
        )
    axis, side, fraction = "xyz".index(match[1]), match[2], float(match[3])
    if not 0.0 <= fraction <= 1.0:
        raise UserError(f"--fixed '{choice}': the fraction of the extent must lie within 0..1")
    along = positions[:, axis]
    level = along.min() + fraction * np.ptp(along)
    chosen = np.flatnonzero(along <= level if side == "<" else along >= level)
    return chosen.astype(np.int32)


def _fixed_from_file(path: Path, count: int) -> Ints:
    try:
        index = np.load(path, allow_pickle=False)
    except FileNotFoundError:
        raise UserError(f"--fixed file {path} does not exist") from None
    except (OSError, ValueError, EOFError):
        raise UserError(f"--fixed file {path} is not a .npy file of indices") from None
    return _indices(index, count, f"--fixed file {path}")


def _indices(index: Array, count: int, name: str) -> Ints:
    if index.ndim != 1 or not np.issubdtype(index.dtype, np.integer):
        raise UserError(f"{name} must hold a 1-D array of integers, has {index.dtype} {index.shape}")
    if len(index) and (index.min() < 0 or index.max() >= count):
        raise UserError(f"{name} names nodes outside 0..{count - 1}")
    return np.unique(index).astype(np.int32)
