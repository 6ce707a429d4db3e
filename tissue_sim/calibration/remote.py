"""Objects that live in processes of their own: two cores work at once only without Python's lock between them."""

from __future__ import annotations

import os
from collections.abc import Callable
from multiprocessing import get_context
from multiprocessing.connection import Connection
from typing import Any

from tissue_sim.child import end_with_parent
from tissue_sim.errors import UserError


class Remote:
    """An object made in a new process by make(*arguments); `ask` calls its methods there, `answer` returns what came.

    Answers come in the order of the questions, and raise what was raised there. The process ends with this one.
    """

    def __init__(self, make: Callable[..., Any], *arguments: Any) -> None:
        context = get_context("spawn")
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(target=_serve, args=(theirs, make, arguments), daemon=True)
        # Read when BLAS is loaded: one thread for each process.
        before = os.environ.get("OPENBLAS_NUM_THREADS")
        os.environ["OPENBLAS_NUM_THREADS"] = "1"
        try:
            self._process.start()
        finally:
            if before is None:
                del os.environ["OPENBLAS_NUM_THREADS"]
            else:
                os.environ["OPENBLAS_NUM_THREADS"] = before
        theirs.close()

    def ask(self, method: str, *arguments: Any) -> None:
        """Call a method there, without waiting."""
        self._pipe.send((method, arguments))

    def answer(self) -> Any:
        """What the oldest question without an answer came to. Raises UserError when the process is gone."""
        try:
            fine, found = self._pipe.recv()
        except (EOFError, OSError):
            raise UserError("a process of the calibration has ended; run it again, it goes on from there") from None
        if not fine:
            raise found
        return found

    def close(self) -> None:
        """End the process."""
        self._process.kill()
        self._process.join()
        self._pipe.close()


def _serve(pipe: Connection, make: Callable[..., Any], arguments: tuple[Any, ...]) -> None:
    """Make the object, answer questions until the other end is closed."""
    end_with_parent()
    made: Any = None
    failure: BaseException | None = None
    try:
        made = make(*arguments)
    except BaseException as error:  # told with the first answer
        failure = error
    while True:
        try:
            method, given = pipe.recv()
        except (EOFError, OSError, KeyboardInterrupt):
            return
        try:
            if failure is not None:
                raise failure
            answer = True, getattr(made, method)(*given)
        except KeyboardInterrupt:
            return
        except BaseException as error:
            answer = False, error
        pipe.send(answer)
