"""Copies of the task Cut: the path of the blade, the cut that it makes in the end, and what that is worth.

A guard slides on the tissue, and a blade of a chosen length protrudes below it. Where the guard touches, its place in
the organ's rest coordinates joins the path of the blade. When the agent says that it has finished, the organ is cut
along that path, as `Scene.cut` does it, and the report of that cut is judged. The blade meets no resistance, unlike
a tool of shape blade: only the guard exerts a force.
"""

from __future__ import annotations

import numpy as np

from tissue_sim.array_types import Floats, Longs
from tissue_sim.environments.blade_path import BladePath, Line, moved_blade
from tissue_sim.environments.copies import TaskCopies
from tissue_sim.environments.steering import declared
from tissue_sim.environments.tasks import Judged
from tissue_sim.errors import UserError
from tissue_sim.organ.organ import Organ

AWAY, MISSED = 0.05, 1.0  # penalty of a step far from what is left of the line, and of a cut that isn't one


class CutCopies(TaskCopies):
    """Copies of the task Cut; parameters are those of TaskCopies."""

    def __init__(self, task: str, count: int, organ: Organ | str | None = None, threads: int = 0) -> None:
        super().__init__(task, count, organ, threads)
        self._rest = self.organ.surface_positions, self.organ.surface_normals
        self._paths = [self._path(copy) for copy in range(count)]

    def begin(self, copies: Longs, randoms: list[np.random.Generator]) -> None:
        """Begin new episodes of some copies, as TaskCopies does."""
        super().begin(copies, randoms)
        self._blade[copies] = 0.0
        for copy in copies.tolist():
            self._paths[copy] = self._path(copy)

    def judge(self, given: Floats) -> Judged:
        """Return what a step is worth, and at the end the cut."""
        self._blade = moved_blade(self._blade, given)
        tips, surfaces = self.batch.poses[:, 0, :3], self.batch.surface_positions()
        force = np.linalg.norm(self.batch.wrenches[:, 0, :3], axis=1)
        away = np.zeros(len(tips))
        for copy, path in enumerate(self._paths):
            path.note(tips[copy], float(self._blade[copy]), float(force[copy]), surfaces[copy], self._rest)
            away[copy] = path.away(tips[copy])
        finished = declared(self.task, given)
        reward, is_good = -AWAY * np.minimum(away / 0.05, 1.0), np.zeros(len(tips), dtype=np.bool_)
        for copy in np.flatnonzero(finished).tolist():
            worth, is_good[copy] = self._worth(copy)
            reward[copy] += worth
        return Judged(reward, is_good, finished)

    def _path(self, copy: int) -> BladePath:
        """Return a path without points."""
        middle, half, outward = self._place[copy].copy(), self._half[copy].copy(), self._outward[copy].copy()
        return BladePath(Line(middle, half, outward, float(self._wanted[copy])))

    def _worth(self, copy: int) -> tuple[float, bool]:
        """Cut the organ along a copy's path; return the reward, and whether the cut is good."""
        path = self._paths[copy]
        cut = path.planned()
        if cut is None:
            return -MISSED, False
        try:
            opened = self.scene.simulation.prepared_cut(cut.polyline, -self._outward[copy], cut.depth)
        except UserError:  # a path that comes back to itself, or is too shallow
            return -MISSED, False
        made = path.judge(cut, opened.cuts[-1].depth)
        return made.worth, made.is_good


def copies_of(task: str, count: int, organ: Organ | str | None = None, threads: int = 0) -> TaskCopies:
    """Return copies of a task; parameters are those of TaskCopies."""
    return (CutCopies if task == "Cut" else TaskCopies)(task, count, organ, threads)
