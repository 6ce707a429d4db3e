"""What takes seconds to work out and is asked for at every start, kept in the user's cache."""

from __future__ import annotations

import contextlib
import os
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

KEPT = 8  # of a kind; the ones used longest ago go


def user_cache() -> Path:
    """The folder of this package in the user's cache; it need not exist."""
    home = os.environ.get("XDG_CACHE_HOME") or os.path.join(os.path.expanduser("~"), ".cache")
    return Path(home) / "tissue_sim"


def used_longest_ago(folder: Path, pattern: str, kept: int) -> list[Path]:
    """What a folder has of a pattern, but for so many that were touched last. Raises OSError where one is gone."""
    return sorted(folder.glob(pattern), key=lambda path: path.stat().st_mtime)[:-kept]


def remembered(kind: str, key: str, make: Callable[[], dict[str, NDArray]]) -> dict[str, NDArray]:
    """Arrays made by `make`, or those of the same kind and key that were kept before.

    A damaged file, a full disk or a home that may not be written to cost time and nothing else.
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
