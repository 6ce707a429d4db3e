"""Compilation of kernels: without the GIL, strictly IEEE, cached on disk, and with a report of how long it takes."""

from __future__ import annotations

import contextlib
import fcntl
import functools
import glob
import hashlib
import os
import shutil
import tempfile
import time
import uuid
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numba
from numba.core import event as events
from numba.core.caching import IndexDataCacheFile
from numba.core.compiler_lock import global_compiler_lock
from numba.extending import overload

from tissue_sim import progress
from tissue_sim.result_cache import used_longest_ago, user_cache

# Kernels, what they are given, and the enumerations that are constants in them.
_COMPILED = b"@kernel", b"@part", b"@short", b"@inner", b"NamedTuple", b"(Record)", b"(IntEnum)"
VERSIONS = 4  # number of versions of a layer's kernels that are kept; the least recently used are removed


def cache_folder(layer: str) -> Path:
    """Return the folder of a layer's compiled kernels, one for each version of their source.

    Numba notices a change in the file of a kernel but not in the files of the kernels that it calls, so the folder's
    name carries a digest of the layer's sources, and of the model's, whose kernels those of contact and calibration
    call. It lies in the user's cache, because the install folder may be read-only, or in the temporary folder when the
    user has no home. When it is created, the least recently used versions are removed.
    """
    digest = hashlib.sha256()
    for own in (Path(__file__), Path(__file__).with_name("handles.py")):
        digest.update(own.read_bytes())
    called = [layer] if layer in ("organ", "model") else [layer, "model"]
    for source in (path for one in called for path in sorted((Path(__file__).parent / one).rglob("*.py"))):
        content = source.read_bytes()
        if any(word in content for word in _COMPILED):
            digest.update(content)
    name = f"{layer}-numba-{numba.__version__}-{digest.hexdigest()[:16]}"
    for base in (user_cache(), Path(tempfile.gettempdir()) / f"tissue_sim-{os.getuid()}"):
        folder = base / name
        is_new = not folder.is_dir()
        try:
            folder.mkdir(parents=True, exist_ok=True)
            os.utime(folder)  # used now
        except OSError:
            continue
        if os.access(folder, os.W_OK):
            if is_new:
                forget_oldest(base, layer)
            return folder
    return Path(tempfile.mkdtemp(prefix="tissue_sim-"))


def forget_oldest(base: Path, layer: str) -> None:
    """Remove a layer's kernels except the VERSIONS used last: each takes a hundred megabytes or more."""
    with contextlib.suppress(OSError):  # another process may remove some at the same time
        for folder in used_longest_ago(base, f"{layer}-numba-*", VERSIONS):
            shutil.rmtree(folder, ignore_errors=True)


_chosen: dict[str, str] = {}


def folder_of(layer: str) -> str:
    """Return where a layer's kernels are kept in this process: NUMBA_CACHE_DIR, or the layer's own folder.

    Parameters
    ----------
    layer : str
        Name of the layer.

    Returns
    -------
    str
        The folder.
    """
    if layer not in _chosen:
        _chosen[layer] = os.environ.get("NUMBA_CACHE_DIR") or str(cache_folder(layer))
    return _chosen[layer]


def is_compiled() -> bool:
    """Return whether the tick of this version was compiled before on this machine."""
    return any(Path(folder_of("model")).rglob("*tick*.nbi"))


def kernel(function: Callable[..., Any]) -> Any:
    """Compile a kernel: no GIL, cached, no fast maths.

    Strict IEEE arithmetic makes ticks repeat bit for bit, on other x86-64 machines too, on which the replay of a bag
    relies.

    Parameters
    ----------
    function : Callable[..., Any]
        The function.

    Returns
    -------
    Any
        The compiled kernel.
    """
    return _compiled(function, "never")


def short(function: Callable[..., Any]) -> Any:
    """Compile a kernel that keeps the GIL: one that only takes microseconds when Python calls it.

    A thread that gives up the GIL for so little often waits for it afterwards, for as long as another one runs.

    Parameters
    ----------
    function : Callable[..., Any]
        The function.

    Returns
    -------
    Any
        The compiled kernel.
    """
    return _compiled(function, "never", nogil=False)


def inner(function: Callable[..., Any]) -> Any:
    """Compile a small kernel that loops call for each point: its machine code becomes a part of theirs.

    The compiler doesn't always do so by itself, and a call reads again where all arrays are.

    Parameters
    ----------
    function : Callable[..., Any]
        The function.

    Returns
    -------
    Any
        The compiled kernel.
    """
    return _compiled(function, "never", forceinline=True)


def part(function: Callable[..., Any]) -> Any:
    """Compile a kernel that one other kernel calls, as a part of it.

    Every level of calls is optimised again with everything below it, so that deep ones take most of the time.

    Parameters
    ----------
    function : Callable[..., Any]
        The function.

    Returns
    -------
    Any
        The compiled kernel.
    """
    return _compiled(function, "always")


def _compiled(function: Callable[..., Any], inline: str, *, nogil: bool = True, forceinline: bool = False) -> Any:
    numba.config.CACHE_DIR = folder_of(function.__module__.split(".")[1])
    # Kernels that allocate nothing need no reference counts around every array that they touch.
    counts = not function.__module__.startswith(("tissue_sim.model.", "tissue_sim.contact."))
    # No kernel is called from C: a wrapper for it would only take time to compile.
    options = {"nogil": nogil, "error_model": "numpy", "no_cfunc_wrapper": True, "_nrt": counts, "inline": inline}
    return compiled_once(numba.njit(**options, forceinline=forceinline)(function))


class CacheFile(IndexDataCacheFile):  # type: ignore[misc]
    """Versions of one kernel on disk, each in a file with a unique name.

    Numba numbers the files and writes the index first: of two processes that save at the same time, or one that loads
    while another saves, one would take machine code that was compiled for other types, and crash.
    """

    def save(self, key: Any, data: Any) -> None:
        """Save a version under its key: first the data, then the index that names it."""
        kernel, folder = Path(self._index_name).stem, Path(self._cache_path)
        name = f"{kernel}.{uuid.uuid4().hex}.nbc"
        self._save_data(name, data)
        named = self._load_index() | {key: name}
        self._save_index(named)
        # What no index names was compiled for an older stamp of the source; whoever is about to load it compiles anew.
        for path in folder.glob(f"{glob.escape(kernel)}.*.nbc"):
            if path.name not in named.values():
                path.unlink(missing_ok=True)


def compiled_once(dispatcher: Any) -> Any:
    """Keep what a dispatcher compiles on disk, and let one process compile what several need when they first start.

    The others wait, and load it. Numba's index of a kernel's versions is also written by one process at a time: if two
    wrote it together, one version would be lost, and compiled again by the next process.

    Parameters
    ----------
    dispatcher : Any
        The dispatcher, without a cache so far.

    Returns
    -------
    Any
        The same dispatcher; the function itself where nothing is compiled.
    """
    if numba.config.DISABLE_JIT:
        return dispatcher
    dispatcher.enable_caching()
    cache, plain = dispatcher._cache, dispatcher._cache._cache_file
    cache._cache_file = CacheFile(plain._cache_path, plain._index_name.removesuffix(".nbi"), plain._source_stamp)
    compile_one, save = dispatcher.compile, cache.save_overload
    name = f"{dispatcher.py_func.__module__}.{dispatcher.py_func.__qualname__}"
    folder = Path(cache.cache_path)

    def compile_once(signature: Any) -> Any:
        version = hashlib.sha256(str(signature).encode()).hexdigest()[:16]
        # Numba's own lock comes first, as in nested compilations: two threads would else wait for each other.
        with global_compiler_lock, alone(folder / f"{name}-{version}.lock"):
            return compile_one(signature)

    def save_alone(signature: Any, compiled: Any) -> None:
        with alone(folder / f"{name}.lock"):
            save(signature, compiled)

    dispatcher.compile, cache.save_overload = compile_once, save_alone
    return dispatcher


@contextlib.contextmanager
def alone(path: Path) -> Iterator[None]:
    """Hold a lock between processes while entered; no lock where the file system has none, as it only saves work."""
    with contextlib.ExitStack() as held:
        with contextlib.suppress(OSError):
            path.parent.mkdir(parents=True, exist_ok=True)
            fcntl.flock(held.enter_context(path.open("a")), fcntl.LOCK_EX)
        yield


def chosen(pick: Callable[..., Any]) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Return a decorator for a function in whose place callers are compiled with one of several kernels.

    Parameters
    ----------
    pick : Callable[..., Any]
        Returns the kernel, given the arguments' compiled types, or the arguments themselves where nothing is compiled;
        all kernels take the arguments of the function, of which only name and description count.

    Returns
    -------
    Callable[[Callable[..., Any]], Callable[..., Any]]
        The decorator.
    """

    def decorate(function: Callable[..., Any]) -> Callable[..., Any]:
        @functools.wraps(function)
        def plain(*arguments: Any) -> Any:
            return pick(*arguments)(*arguments)

        @overload(plain)
        def _compiled_choice(*arguments):  # type: ignore[no-untyped-def]
            kernel = pick(*arguments)
            return lambda *arguments: kernel(*arguments)  # noqa: PLW0108 - Numba takes no kernel here

        return plain

    return decorate


class _Compiling(events.Listener):
    """Listener that reports how long the compiler takes for kernels of this package; cached kernels cause no event."""

    def __init__(self) -> None:
        self._depth = 0  # of kernels that are compiled for others; one thread compiles at a time
        self._seconds = 0.0  # of all of them, as one tick has several
        self._reporting = ExitStack()

    def on_start(self, event: events.Event) -> None:
        """Note that a kernel begins."""
        if not _is_own(event):
            return
        self._depth += 1
        if self._depth == 1:
            self._began = time.monotonic()
            task = self._reporting.enter_context(progress.task("compiling kernels, once for this version"))
            task.started -= self._seconds

    def on_end(self, event: events.Event) -> None:
        """Note that it is done, or has failed."""
        if not _is_own(event):
            return
        self._depth -= 1
        if self._depth == 0:
            self._seconds += time.monotonic() - self._began
            self._reporting.close()


def _is_own(event: events.Event) -> bool:
    """Return whether an event is about a kernel of this package."""
    return str(event.data["dispatcher"].py_func.__module__).startswith("tissue_sim.")


events.register("numba:compile", _Compiling())
