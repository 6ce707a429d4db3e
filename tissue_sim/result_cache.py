"""Cache of results that take seconds to compute and are needed at every start."""

from __future__ import annotations

import contextlib
import os
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

KEPT = 8  # number of a kind; the least recently used are removed


def user_cache() -> Path:
    """Return the folder of this package in the user's cache; it need not exist."""
    home = os.environ.get("XDG_CACHE_HOME") or os.path.join(os.path.expanduser("~"), ".cache")
    return Path(home) / "tissue_sim"


def used_longest_ago(folder: Path, pattern: str, kept: int) -> list[Path]:
    """Return a folder's files of a pattern, except those that were used last.

    pattern: glob pattern; kept: number of files that are left out, the most recently used ones. Returns the files, the
    least recently used first. Raises OSError where a file is removed meanwhile.
    """
    return sorted(folder.glob(pattern), key=lambda path: path.stat().st_mtime)[:-kept]


def remembered(kind: str, key: str, make: Callable[[], dict[str, NDArray]]) -> dict[str, NDArray]:
    """Return the arrays kept under a kind and key, or those that `make` returns now.

    A damaged file, a full disk or a home that may not be written to cost time and nothing else.

    kind: kind of result; key: identifies the inputs; make: computes the arrays. Returns arrays by name.
    """
    folder = user_cache()
    path = folder / f"{kind}-{key[:24]}.npz"
    try:
        with np.load(path, allow_pickle=False) as stored:
            arrays = {name: stored[name] for name in stored.files}
        path.touch()
        return arrays
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        pass
    arrays = make()
    part = folder / f".{kind}-{key[:24]}-{os.getpid()}.npz"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        np.savez(part, **arrays)  # type: ignore[arg-type]
        part.replace(path)
        for old in used_longest_ago(folder, f"{kind}-*.npz", KEPT):
            old.unlink(missing_ok=True)
    except OSError:
        with contextlib.suppress(OSError):
            part.unlink(missing_ok=True)
    return arrays
