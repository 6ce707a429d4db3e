"""Waiting for what another thread or process does."""

import time
from collections.abc import Callable
from typing import Any


def wait_for(value: Callable[[], Any], timeout: float, problem: str = "it never came true") -> Any:
    """The value as soon as it is true."""
    end = time.monotonic() + timeout
    while not (found := value()):
        assert time.monotonic() < end, problem
        time.sleep(0.02)
    return found
