"""How the kernels are compiled: without the GIL, strictly IEEE, cached on disk."""

from __future__ import annotations

import hashlib
import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba


def cache_folder() -> Path:
    """Folder of the compiled kernels, one for each version of their source.

    Numba notices a change in the file of a kernel but not in the files of the kernels that it
    calls, so the folder's name carries a digest of them all. It lies in the user's cache, because
    the install folder may be read-only, or in the temporary folder when the user has no home.
    """
    digest = hashlib.sha256()
    for source in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(source.read_bytes())
    name = f"numba-{numba.__version__}-{digest.hexdigest()[:16]}"
    home = os.environ.get("XDG_CACHE_HOME") or os.path.join(os.path.expanduser("~"), ".cache")
    for base in (Path(home) / "tissue_sim", Path(tempfile.gettempdir()) / f"tissue_sim-{os.getuid()}"):
        folder = base / name
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError:
            continue
        if os.access(folder, os.W_OK):
            return folder
    return Path(tempfile.mkdtemp(prefix="tissue_sim-"))


if not os.environ.get("NUMBA_CACHE_DIR"):
    numba.config.CACHE_DIR = str(cache_folder())


def is_compiled() -> bool:
    """True when the kernels of this version were compiled before on this machine."""
    return any(Path(numba.config.CACHE_DIR).rglob("*tick*.nbi"))


def kernel(function: Callable[..., Any]) -> Any:
    """Compile a kernel: no GIL, cached, no fast maths.

    Strict IEEE arithmetic makes ticks repeat bit for bit, on other x86-64 machines too, which is
    what the replay of a bag stands on.
    """
    return numba.njit(cache=True, nogil=True, error_model="numpy")(function)
