"""What the making of an organ tells on its way: the stages, how far they are, and what each of them made."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from tissue_sim.array_types import Floats

if TYPE_CHECKING:
    from tissue_sim.organ.imaging.image import Volume
    from tissue_sim.organ.organ import Organ
    from tissue_sim.organ.request import Request
    from tissue_sim.organ.segmenting.segmentation import Segmentation
    from tissue_sim.organ.skeletons.skeleton import Skeleton
    from tissue_sim.organ.surfaces.balloon import Balloon
    from tissue_sim.organ.surfaces.surface import Wall

Tell = Callable[[str], None]
Watch = Callable[[str, float], None]  # stage, share of it that is done

STAGES = ("read", "segment", "wall", "balloon", "skeleton", "springs")


@dataclass
class BuildRecord:
    """What the stages made on the way, for the report; references only, nothing is copied.

    frame: `LPS` for an image's patient frame, `mesh` for the frame of a mesh file. seconds: of each stage, in order.
    lines: what was told; warnings: those of them that warn.
    """

    frame: str = "LPS"
    ct: Volume | None = None
    seed: Floats | None = None  # (3,) mm
    segmentation: Segmentation | None = None
    mask: Volume | None = None
    wall: Wall | None = None
    balloon: Balloon | None = None
    skeleton: Skeleton | None = None
    organ: Organ | None = None
    request: Request | None = None
    repairs: tuple[str, ...] = ()
    seconds: dict[str, float] = field(default_factory=dict)
    lines: list[str] = field(default_factory=list)

    @property
    def warnings(self) -> list[str]:
        """The lines that warn, without the word."""
        return [line.removeprefix("warning: ") for line in self.lines if line.startswith("warning: ")]


def _quiet(_line: str) -> None:
    return None


def _unwatched(_stage: str, _done: float) -> None:
    return None


@dataclass
class Progress:
    """Where the stages tell what they found, how far they are and what they made."""

    tell: Tell = _quiet
    watch: Watch = _unwatched
    record: BuildRecord = field(default_factory=BuildRecord)

    def say(self, line: str) -> None:
        """Tell a line and keep it."""
        self.record.lines.append(line)
        self.tell(line)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time a stage and watch its beginning and end."""
        self.watch(name, 0.0)
        started = time.perf_counter()
        yield
        seconds = self.record.seconds
        seconds[name] = seconds.get(name, 0.0) + time.perf_counter() - started
        self.watch(name, 1.0)

    def at(self, stage: str, done: float) -> None:
        """Tell the share of a stage that is done, 0..1."""
        self.watch(stage, min(max(done, 0.0), 1.0))

    def took(self, name: str) -> str:
        """The stage's time as text."""
        return f"({self.record.seconds[name]:.1f} s)"
