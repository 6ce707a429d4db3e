"""Memory below Python: bounds for libraries that take a damaged file's lengths at their word, and what bursts leave."""

from __future__ import annotations

import ctypes
import resource
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def limited(spare: int) -> Iterator[None]:
    """While entered, this process may reserve so many bytes more than it has; not for use beside busy threads.

    What asks for more raises what its library makes of it: RuntimeError or MemoryError.
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
    """Give the system the room that the allocator keeps of blocks that were freed; a millisecond for some 100 MB.

    After bursts, such as a disk that stood still leaves, it keeps some of it for good: MB in an hour of recording.
    """
    if _trim is not None:
        _trim(0)
