"""Intermediate results of a long calculation, kept in a folder, so that it continues after it was stopped."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from tissue_sim.array_types import Array
from tissue_sim.errors import UserError
from tissue_sim.json_types import JsonMapping

Arrays = dict[str, Array]

KEPT = "results"  # where in its folder


class Checkpoint:
    """Results by name, kept by joblib in a folder for one set of inputs.

    Results that are requested again with the same inputs come back bit for bit, so that a calculation that is run again
    quickly reaches where it was stopped, and ends as if it had not been.

    Parameters
    ----------
    folder : Path
        The folder.
    inputs : JsonMapping
        What the results depend on, as JSON can hold it.

    Raises
    ------
    UserError
        Where the folder can't be written, or joblib is missing.
    """

    def __init__(self, folder: Path, inputs: JsonMapping) -> None:
        try:
            from joblib import Memory
        except ModuleNotFoundError:
            raise UserError("a calibration needs joblib: pip install 'tissue_sim[calibration]'") from None
        self._folder, self._inputs = folder, json.dumps(dict(inputs), sort_keys=True)
        try:
            self._made = Memory(folder / KEPT, verbose=0).cache(_made, ignore=["make"])
            self.found = self._made.check_call_in_cache(self._inputs, "begun", dict)  # the folder has results
            self.remember("begun", dict)
        except OSError as error:
            raise UserError(f"cannot write {folder}: {error.strerror}") from None

    def remember(self, name: str, make: Callable[[], Arrays]) -> Arrays:
        """Return the arrays kept under a name, or those that `make` returns now.

        Parameters
        ----------
        name : str
            Name of the result.
        make : Callable[[], Arrays]
            Computes it.

        Returns
        -------
        Arrays
            Arrays by name.
        """
        arrays: Arrays = self._made(self._inputs, name, make)
        return arrays

    def remove(self) -> None:
        """Remove what was kept; the calculation is complete."""
        shutil.rmtree(self._folder / KEPT, ignore_errors=True)
        with suppress(OSError):  # the folder may hold other files
            self._folder.rmdir()


def _made(inputs: str, name: str, make: Callable[[], Arrays]) -> Arrays:
    return make()
