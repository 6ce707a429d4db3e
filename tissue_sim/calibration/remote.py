"""Objects in separate processes: two cores work at the same time only without Python's lock between them."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing import get_context
from multiprocessing.managers import BaseManager
from typing import Any

from tissue_sim.environment import environment
from tissue_sim.errors import UserError
from tissue_sim.parent_exit import exit_with_parent
from tissue_sim.progress_reporter import SETTING

# One thread for each BLAS, which reads it when it is loaded; progress is reported by this process, which waits for it.
_SETTING = {"OPENBLAS_NUM_THREADS": "1", SETTING: "0"}


class Remote:
    """Object made in a new process by make(*arguments), which must not fail.

    The process ends with this one. What the object keeps between calls (factored matrices) never leaves it: workers
    that are handed every task separately, as joblib's are, would compute it again.

    Parameters
    ----------
    make : Callable[..., object]
        Makes the object.
    arguments : object
        Arguments of `make`.
    """

    def __init__(self, make: Callable[..., object], *arguments: object) -> None:
        self._manager = _Process(ctx=get_context("spawn"))
        with environment(_SETTING), _script_hidden():
            self._manager.start(exit_with_parent)
        self._object = self._manager.make(make, *arguments)  # type: ignore[attr-defined]

    def call(self, method: str, *arguments: object) -> Any:
        """Return what a method returns, or raise what it raises.

        Parameters
        ----------
        method : str
            Name of the method.
        arguments : object
            Its arguments.

        Raises
        ------
        UserError
            Where the process has ended.
        """
        try:
            return getattr(self._object, method)(*arguments)
        except (EOFError, ConnectionError, FileNotFoundError):  # the last: its socket
            raise UserError("a process of the calibration has ended; run it again to continue from there") from None

    def close(self) -> None:
        """End the process, whatever it is doing."""
        # On shutdown alone it would not react while a mesh is made, which doesn't release Python's lock.
        process = self._manager._process  # type: ignore[attr-defined]
        if process is not None:
            process.kill()
            process.join()
        self._manager.shutdown()


@contextmanager
def _script_hidden() -> Iterator[None]:
    """Keep a new process from running the user's script again: it needs none of it, and few scripts have a guard."""
    main = sys.modules["__main__"]
    kept: dict[str, object] = {name: main.__dict__[name] for name in ("__file__", "__spec__") if name in main.__dict__}
    main.__dict__.pop("__file__", None)
    main.__spec__ = None
    try:
        yield
    finally:
        main.__dict__.update(kept)


class _Process(BaseManager):
    """Process that makes the object."""


def _make(make: Callable[..., object], *arguments: object) -> object:
    return make(*arguments)


_Process.register("make", _make)
