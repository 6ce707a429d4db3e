"""Waiting for what another thread or process does."""

import time
from collections.abc import Callable
from typing import Any

LIMIT = 300.0  # s: what has not happened by then on the slowest machine never will


def wait_for(value: Callable[[], Any], problem: str | Callable[[], str] = "it never came true") -> Any:
    """The value as soon as it is true."""
    end = time.monotonic() + LIMIT
    while not (found := value()):
        assert time.monotonic() < end, problem if isinstance(problem, str) else problem()
        time.sleep(0.005)
    return found
