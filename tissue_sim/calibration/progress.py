"""Receivers of the progress of a calibration."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import Protocol


class Progress(Protocol):
    """Receiver of the progress of a calibration."""

    def stage(self, name: str, total: int) -> AbstractContextManager[Callable[..., None]]:
        """Start a stage of `total` steps; the result is called after each, with a remark if there is one."""
        ...


class Silent:
    """A progress without output."""

    @contextmanager
    def stage(self, name: str, total: int) -> Iterator[Callable[..., None]]:
        """See Progress."""
        yield lambda remark="": None
