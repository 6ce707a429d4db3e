"""Memory below Python: limits for libraries that trust lengths, release of what bursts leave, pages that are there."""

from __future__ import annotations

import ctypes
import resource
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np


@contextmanager
def limited(spare: int) -> Iterator[None]:
    """Limit the memory that this process may reserve to `spare` bytes more; not for use beside busy threads.

    A request for more raises whatever the library makes of it: RuntimeError or MemoryError.

    Parameters
    ----------
    spare : int
        Bytes beyond those reserved now.
    """
    before, most = resource.getrlimit(resource.RLIMIT_AS)
    limit = _reserved() + spare
    limits = [one for one in (limit, before, most) if one != resource.RLIM_INFINITY]
    resource.setrlimit(resource.RLIMIT_AS, (min(limits), most))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (before, most))


def _reserved() -> int:
    return int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0]) * resource.getpagesize()


_trim = getattr(ctypes.CDLL(None), "malloc_trim", None)  # glibc's


def give_back() -> None:
    """Return freed memory that the allocator keeps to the system; a millisecond per about 100 MB.

    After bursts, such as a stalled disk causes, the allocator keeps some of it for good: MB in an hour of recording.
    """
    if _trim is not None:
        _trim(0)


def provide(values: object) -> None:
    """Have the system provide the memory of arrays, which otherwise it does page by page as each is first written to.

    A thread that must not wait, and that is handed new arrays, would wait for each page: some of them for a
    millisecond, while other threads reserve and free memory.

    Parameters
    ----------
    values : object
        An array, or a NamedTuple of such and of further ones; they must not be in use.
    """
    if isinstance(values, tuple):
        for one in values:
            provide(one)
    elif isinstance(values, np.ndarray) and values.flags.c_contiguous and values.flags.writeable and values.size:
        pages = values.reshape(-1).view(np.uint8)[:: resource.getpagesize()]
        pages[:] = pages.copy()
