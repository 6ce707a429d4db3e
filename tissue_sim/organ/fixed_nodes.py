"""Selection of the surface nodes of an organ that are held."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from tissue_sim.array_types import Floats, Ints
from tissue_sim.errors import UserError

_FIXED = re.compile(r"([xyz])\s*([<>])\s*([0-9]*\.?[0-9]+)")


def select_fixed(choice: str, positions: Floats) -> Ints:
    """Return the indices of the surface nodes that a choice names.

    Parameters
    ----------
    choice : str
        `none`, a .npy file of indices, or a part of the extent along an axis: `z<0.1` is the lowest tenth along z.
    positions : Floats, shape (n, 3), m
        Surface nodes.

    Returns
    -------
    Ints, shape (k,)
        Indices of the held nodes, ascending.

    Raises
    ------
    UserError
        Where the choice isn't understood, or its file doesn't hold indices of the nodes.
    """
    text = choice.strip()
    if text.lower() == "none":
        return np.empty(0, dtype=np.int32)
    if text.endswith(".npy"):
        return _fixed_from_file(Path(text), len(positions))
    match = _FIXED.fullmatch(text)
    if match is None:
        raise UserError(f"--fixed '{choice}' is not understood; use 'z<0.1' (axis, < or >, share), a .npy file or none")
    axis, side, share = "xyz".index(match[1]), match[2], float(match[3])
    if not 0.0 <= share <= 1.0:
        raise UserError(f"--fixed '{choice}': the share of the extent must lie within 0..1")
    along = positions[:, axis]
    level = along.min() + share * np.ptp(along)
    chosen = np.flatnonzero(along <= level if side == "<" else along >= level)
    return chosen.astype(np.int32)


def _fixed_from_file(path: Path, count: int) -> Ints:
    try:
        index = np.load(path, allow_pickle=False)
    except FileNotFoundError:
        raise UserError(f"--fixed file {path} does not exist") from None
    except (OSError, ValueError, EOFError):
        raise UserError(f"--fixed file {path} is no .npy file of indices") from None
    if index.ndim != 1 or not np.issubdtype(index.dtype, np.integer):
        raise UserError(f"--fixed file {path} must hold a 1-D array of integers, has {index.dtype} {index.shape}")
    if len(index) and (index.min() < 0 or index.max() >= count):
        raise UserError(f"--fixed file {path} names nodes outside 0..{count - 1}")
    return np.unique(index).astype(np.int32)
