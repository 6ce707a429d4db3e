"""Bounds the memory of libraries below Python that take a damaged file's lengths at their word."""

from __future__ import annotations

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
