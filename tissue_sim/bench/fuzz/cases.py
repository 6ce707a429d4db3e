"""Cases of hostile input, their possible outcomes, and the kinds of cases."""

from __future__ import annotations

import importlib
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from tissue_sim.organ.shipped import shipped_file


class Case(NamedTuple):
    """One hostile input, which is determined by these three fields."""

    kind: str
    seed: int
    number: int

    def rng(self) -> np.random.Generator:
        """Return the random numbers of this case alone."""
        return np.random.default_rng([self.seed, zlib.crc32(self.kind.encode()), self.number])


Verdict = Literal["used", "refused", "failed"]


class Outcome(NamedTuple):
    """Outcome of a case: used, refused with one line, or failed with the reason."""

    case: Case
    verdict: Verdict
    line: str
    what: str = ""  # the input, in a few words
    seconds: float = 0.0
    megabytes: float = 0.0  # memory beyond what the process had before

    def as_json(self) -> dict[str, Any]:
        """Return its fields, flat."""
        return {**self.case._asdict(), **{key: value for key, value in self._asdict().items() if key != "case"}}


class Broken(Exception):
    """Error with one line: a result breaks what is promised."""


class Input(NamedTuple):
    """Hostile input, ready to be used.

    Attributes
    ----------
    what : str
        Description in a few words.
    use : Callable[[], str]
        Uses it and returns a line on the result. Raises UserError where it refuses, Broken where a promise is broken;
        any other exception is a failure.
    """

    what: str
    use: Callable[[], str]


class Kind(NamedTuple):
    """Kind of cases.

    Attributes
    ----------
    module : str
        Has `prepare(case, folder) -> Input`, and `warm_up(folder)`, which does once in a process what every case needs,
        so that its time and memory aren't counted.
    what : str
        Description.
    megabytes : float
        Memory that a case may take.
    seconds : float
        Time that a case may take.
    needs : str
        File of the checkout without which there are no such cases.
    last : bool
        Whether its cases come after all others, because their server is restarted between kinds.
    """

    module: str
    what: str
    megabytes: float = 400.0
    seconds: float = 60.0
    needs: str = ""
    last: bool = False

    @property
    def missing(self) -> bool:
        """Whether this installation lacks what it needs."""
        return bool(self.needs) and shipped_file(self.needs) is None

    def prepare(self, case: Case, folder: Path) -> Input:
        """Make the input of a case in an empty folder."""
        made: Input = importlib.import_module(self.module).prepare(case, folder)
        return made

    def warm_up(self, folder: Path) -> None:
        """Do once in a process what every case needs."""
        importlib.import_module(self.module).warm_up(folder)


SCENE = "bags/bad_input/metadata.yaml"  # of a bag that the tests replay

FILES = {
    "organ": Kind("tissue_sim.bench.fuzz.files.organs", "organ files (.npz): loaded, and simulated for some ticks"),
    "image": Kind("tissue_sim.bench.fuzz.files.images", "NIfTI, NRRD, MHA and DICOM: read as an image or a mask"),
    "segmentation": Kind("tissue_sim.bench.fuzz.files.segmentations", "DICOM segmentations: a segment of one is read"),
    "mesh": Kind("tissue_sim.bench.fuzz.files.meshes", "meshes of every format: read, repaired and voxelised"),
    "bag": Kind(
        "tissue_sim.bench.fuzz.files.bags",
        "bags: completed if they were interrupted, replayed, compared",
        seconds=300.0,  # one may list a part thrice
        needs=SCENE,
    ),
}
SCENES = {
    "tick": Kind("tissue_sim.bench.fuzz.scenes.ticks", "tools, loads and settings, tick by tick", seconds=120.0),
    "joined": Kind(
        "tissue_sim.bench.fuzz.scenes.joined", "two organs that touch, are joined and breathe", seconds=240.0
    ),
    "node": Kind("tissue_sim.bench.fuzz.scenes.node", "messages and services, to a running node over DDS"),
    "scene_node": Kind(
        "tissue_sim.bench.fuzz.scenes.node", "the same, to a node of two organs that breathe", last=True
    ),
}
KINDS: dict[str, Kind] = {**FILES, **SCENES}
