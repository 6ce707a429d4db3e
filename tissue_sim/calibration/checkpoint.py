"""What a long calculation has reached, kept in a folder, so that it goes on after it was stopped."""

from __future__ import annotations

import json
import shutil
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissue_sim.errors import UserError

Arrays = dict[str, NDArray[Any]]


class Checkpoint:
    """Results by name, in a folder that belongs to one set of inputs; without a folder nothing is kept.

    Whatever is asked for twice with the same inputs comes back bit for bit, so that a calculation that is
    run again runs quickly to where it was stopped, and ends as if it had not been.
    Raises UserError when the folder can't be written.
    """

    def __init__(self, folder: Path | None, inputs: Mapping[str, Any]) -> None:
        self._folder = folder
        self.found = False  # True when the folder held results of the same inputs
        if folder is None:
            return
        text = json.dumps(dict(inputs), sort_keys=True)
        key = folder / "inputs.json"
        try:
            self.found = key.is_file() and key.read_text(encoding="utf-8") == text
            if not self.found:
                if folder.exists() and not key.is_file() and any(folder.iterdir()):
                    raise UserError(f"{folder} holds something else than a calibration under way; move it away")
                shutil.rmtree(folder, ignore_errors=True)
                folder.mkdir(parents=True)
                key.write_text(text, encoding="utf-8")
        except OSError as error:
            raise UserError(f"cannot write {folder}: {error.strerror}") from None

    def remember(self, name: str, make: Callable[[], Arrays]) -> Arrays:
        """Arrays of this name from before, or those that `make` returns now."""
        kept = self.load(name)
        if kept is not None:
            return kept
        arrays = make()
        self.store(name, arrays)
        return arrays

    def load(self, name: str) -> Arrays | None:
        """Arrays of this name, None when there are none; one that was cut short counts as none."""
        if self._folder is None:
            return None
        try:
            with np.load(self._folder / f"{name}.npz", allow_pickle=False) as stored:
                return {key: stored[key] for key in stored.files}
        except (OSError, ValueError, EOFError, zipfile.BadZipFile):
            return None

    def store(self, name: str, arrays: Arrays) -> None:
        """Keep arrays under a name, whole or not at all."""
        if self._folder is None:
            return
        part = self._folder / f".{name}.part"
        try:
            with part.open("wb") as stream:
                np.savez(stream, **arrays)  # type: ignore[arg-type]
            part.replace(self._folder / f"{name}.npz")
        except OSError as error:
            raise UserError(f"cannot write to {self._folder}: {error.strerror}") from None

    def remove(self) -> None:
        """Remove the folder; the calculation is done."""
        if self._folder is not None:
            shutil.rmtree(self._folder, ignore_errors=True)
