"""What a case is, what may come of it, and the kinds of cases there are."""

from __future__ import annotations

import importlib
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from tissue_sim.organ.shipped import shipped_file


class Case(NamedTuple):
    """One hostile input: all of it follows from these three."""

    kind: str
    seed: int
    number: int

    def rng(self) -> np.random.Generator:
        """Random numbers of this case alone."""
        return np.random.default_rng([self.seed, zlib.crc32(self.kind.encode()), self.number])


Verdict = Literal["used", "refused", "failed"]


class Outcome(NamedTuple):
    """What came of a case: used, refused with one line, or failed with the reason."""

    case: Case
    verdict: Verdict
    line: str
    what: str = ""  # the input, in a few words
    seconds: float = 0.0
    megabytes: float = 0.0  # memory beyond what the process had before

    def as_json(self) -> dict[str, Any]:
        """Its fields, flat."""
        return {**self.case._asdict(), **{key: value for key, value in self._asdict().items() if key != "case"}}


class Broken(Exception):
    """What was made of an input breaks what is promised, in one line."""


class Input(NamedTuple):
    """A hostile input, ready: in a few words, and what uses it.

    use returns a line on what came of it. It raises UserError where it refuses, Broken where it finds that a promise
    is broken; whatever else it raises is a failure.
    """

    what: str
    use: Callable[[], str]


class Kind(NamedTuple):
    """A kind of cases. module: has `prepare(case, folder) -> Input` and `warm_up(folder)`.

    warm_up does once in a process what every case needs, so that its time and memory count for none.
    megabytes, seconds: what a case may take. needs: a file of the checkout, without which there are no such cases.
    last: whether its cases come after all of others, as what serves them is begun anew between its kind and another.
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
        """See above."""
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
