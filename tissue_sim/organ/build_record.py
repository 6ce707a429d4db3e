"""Record of how an organ is made: the stages, their progress, and what each of them produced."""

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

Write = Callable[[str], None]
Watch = Callable[[str, float], None]  # stage, fraction of it that is done

STAGES = ("read", "segment", "wall", "balloon", "skeleton", "springs")


@dataclass
class BuildRecord:
    """Results of the stages of a build, kept for the report; they are references, nothing is copied.

    Attributes
    ----------
    frame : str
        `LPS` for an image's patient frame, `mesh` for the frame of a mesh file.
    seed : Floats | None, shape (3,), mm
        Seed point of the segmentation.
    seconds : dict[str, float]
        Duration of each stage, in their order.
    lines : list[str]
        Lines that were reported, warnings included.
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
        """Lines of warnings, without their prefix."""
        return [line.removeprefix("warning: ") for line in self.lines if line.startswith("warning: ")]


def _quiet(_line: str) -> None:
    return None


def _unobserved(_stage: str, _done: float) -> None:
    return None


@dataclass
class Progress:
    """Receiver of what the stages of a build report: findings, progress and results.

    Attributes
    ----------
    write : Write
        Called with each line.
    watch : Watch
        Called with a stage and the fraction of it that is done.
    record : BuildRecord
        What has been reported and produced so far.
    """

    write: Write = _quiet
    watch: Watch = _unobserved
    record: BuildRecord = field(default_factory=BuildRecord)

    def say(self, line: str) -> None:
        """Report a line and keep it in the record.

        Parameters
        ----------
        line : str
            The line.
        """
        self.record.lines.append(line)
        self.write(line)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time a stage and report its beginning and end.

        Parameters
        ----------
        name : str
            One of STAGES.
        """
        self.watch(name, 0.0)
        started = time.perf_counter()
        yield
        seconds = self.record.seconds
        seconds[name] = seconds.get(name, 0.0) + time.perf_counter() - started
        self.watch(name, 1.0)

    def at(self, stage: str, done: float) -> None:
        """Report the fraction of a stage that is done.

        Parameters
        ----------
        stage : str
            One of STAGES.
        done : float
            Fraction done; values outside 0..1 are clipped.
        """
        self.watch(stage, min(max(done, 0.0), 1.0))

    def took(self, name: str) -> str:
        """Return the duration of a stage as text, in brackets.

        Parameters
        ----------
        name : str
            Name of the stage.
        """
        return f"({self.record.seconds[name]:.1f} s)"
