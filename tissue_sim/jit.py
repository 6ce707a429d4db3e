"""How every kernel is compiled: without the GIL, strictly IEEE, cached on disk."""

from __future__ import annotations

import hashlib
import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba


def cache_folder(layer: str) -> Path:
    """Folder of a layer's compiled kernels, one for each version of their source.

    Numba notices a change in the file of a kernel but not in the files of the kernels that it
    calls, so the folder's name carries a digest of all that the layer has. It lies in the user's cache, because
    the install folder may be read-only, or in the temporary folder when the user has no home.
    """
    digest = hashlib.sha256(Path(__file__).read_bytes())
    for source in sorted((Path(__file__).parent / layer).rglob("*.py")):
        content = source.read_bytes()
        if b"@kernel" in content or b"NamedTuple" in content:  # kernels and what they are given
            digest.update(content)
    name = f"{layer}-numba-{numba.__version__}-{digest.hexdigest()[:16]}"
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


_chosen: dict[str, str] = {}


def folder_of(layer: str) -> str:
    """Where a layer's kernels are kept in this process: NUMBA_CACHE_DIR, or the layer's own folder."""
    if layer not in _chosen:
        _chosen[layer] = os.environ.get("NUMBA_CACHE_DIR") or str(cache_folder(layer))
    return _chosen[layer]


def is_compiled() -> bool:
    """True when the tick of this version was compiled before on this machine."""
    return any(Path(folder_of("model")).rglob("*tick*.nbi"))


def kernel(function: Callable[..., Any]) -> Any:
    """Compile a kernel: no GIL, cached, no fast maths.

    Strict IEEE arithmetic makes ticks repeat bit for bit, on other x86-64 machines too, which is
    what the replay of a bag stands on.
    """
    numba.config.CACHE_DIR = folder_of(function.__module__.split(".")[1])
    return numba.njit(cache=True, nogil=True, error_model="numpy")(function)
