"""Copies of the task Cut: the way of the blade, the cut that it makes in the end, and what that is worth.

A guard slides on the tissue, and a blade of a chosen length protrudes below it. Where the guard touches, its place in
the organ's rest coordinates joins the way of the blade. When the agent says that it has finished, the organ is cut
along that way, as `Scene.cut` does it, and the report of that cut is judged. The blade meets no resistance, unlike
a tool of shape blade: only the guard exerts a force.
"""

from __future__ import annotations

import numpy as np

from tissue_sim.array_types import Floats, Longs, Singles
from tissue_sim.environments.copies import TaskCopies
from tissue_sim.environments.steering import declared, turned_about_z
from tissue_sim.environments.tasks import DECLARED, STEP, TOUCH, Judged
from tissue_sim.errors import UserError
from tissue_sim.organ.organ import Organ

BLADE_SPEED, LONGEST_BLADE = 0.05, 0.02  # m/s at an action of 1; m
APART, SPACING = 5e-4, 0.005  # m between noted points of a way, and between corners of the cut
SHORTEST = 0.004  # m, a way that is no cut
SAMPLES, REACH = 21, 0.003  # points of the line, and m from the way within which one is cut
AWAY, MISSED = 0.05, 1.0  # penalty of a step far from what is left of the line, and of a cut that isn't one
LINE, DEPTH = 0.005, 0.5  # m beside the line, and part of the depth, at which a cut is worth nothing
GOOD_LINE, GOOD_DEPTH, MOST_FORCE = 0.002, 0.15, 1.0  # of a success: m, part of the depth, N of the guard at most


class CutCopies(TaskCopies):
    """Copies of the task Cut; parameters are those of TaskCopies."""

    def __init__(self, task: str, count: int, organ: Organ | str | None = None, threads: int = 0) -> None:
        super().__init__(task, count, organ, threads)
        self._blade, self._peak = np.zeros(count), np.zeros(count)  # m, N
        self._normals = self.organ.surface_normals
        self._ways: list[list[Floats]] = [[] for _ in range(count)]  # points (4,) m: where, and how deep
        self._is_cut = np.zeros((count, SAMPLES), dtype=np.bool_)

    def begin(self, copies: Longs, randoms: list[np.random.Generator]) -> None:
        """Begin new episodes of some copies, as TaskCopies does."""
        super().begin(copies, randoms)
        self._blade[copies] = self._peak[copies] = 0.0
        self._is_cut[copies] = False
        for copy in copies.tolist():
            self._ways[copy] = []

    def observe(self) -> dict[str, Singles]:
        """Return the observations of all copies: also both ends of the line, and how far the blade protrudes."""
        half = turned_about_z(self._half, self._heading)
        middle = self.outside(self._place)
        line = np.hstack([middle - half, middle + half])
        more = {"line": line, "blade": self._blade[:, None]}
        return super().observe() | {name: values.astype(np.float32) for name, values in more.items()}

    def judge(self, given: Floats) -> Judged:
        """Return what a step is worth, and at the end the cut."""
        self._blade = np.clip(self._blade + STEP * BLADE_SPEED * given[:, 3], 0.0, LONGEST_BLADE)
        tips = self.batch.poses[:, 0, :3]
        force = np.linalg.norm(self.batch.wrenches[:, 0, :3], axis=1)
        self._peak = np.maximum(self._peak, force)
        self._note(tips, force)
        line = self._lines()
        away = np.linalg.norm(line - tips[:, None], axis=2)
        away = np.where(self._is_cut, np.inf, away).min(axis=1)
        away[self._is_cut.all(axis=1)] = 0.0
        finished = declared(self.task, given)
        reward, is_good = -AWAY * np.minimum(away / 0.05, 1.0), np.zeros(len(tips), dtype=np.bool_)
        for copy in np.flatnonzero(finished).tolist():
            worth, is_good[copy] = self._worth(copy)
            reward[copy] += worth
        return Judged(reward, is_good, finished)

    def _note(self, tips: Floats, force: Floats) -> None:
        """Note where blades are in the tissue, in the organ's rest coordinates."""
        surfaces, rest, normals = self.batch.surface_positions(), self.organ.surface_positions, self._normals
        for copy in np.flatnonzero((force > TOUCH) & (self._blade > 0.0)).tolist():
            node = int(np.argmin(np.linalg.norm(surfaces[copy] - tips[copy], axis=1)))
            # The guard dents the tissue between the nodes, too: its place on the surface at rest is what counts.
            point = tips[copy] - (surfaces[copy, node] - rest[node])
            point -= ((point - rest[node]) @ normals[node]) * normals[node]
            way = self._ways[copy]
            if not way or np.linalg.norm(point - way[-1][:3]) >= APART:
                way.append(np.append(point, self._blade[copy]))
            self._is_cut[copy] |= np.linalg.norm(self._across(copy, self._lines()[copy] - point), axis=1) < REACH

    def _lines(self) -> Floats:
        """Return points (n, SAMPLES, 3) m of the lines."""
        fraction = np.linspace(-1.0, 1.0, SAMPLES)[None, :, None]
        return np.asarray(self._place[:, None] + fraction * self._half[:, None])

    def _across(self, copy: int, ways: Floats) -> Floats:
        """Return ways (k, 3) as they are seen along the normal at the place."""
        outward = self._outward[copy]
        return np.asarray(ways - np.outer(ways @ outward, outward))

    def _worth(self, copy: int) -> tuple[float, bool]:
        """Cut the organ along a copy's way; return the reward, and whether the cut is good."""
        way = np.array(self._ways[copy]).reshape(-1, 4)
        steps = np.linalg.norm(np.diff(way[:, :3], axis=0), axis=1)
        if steps.sum() < SHORTEST:
            return -MISSED, False
        run = np.concatenate([[0.0], np.cumsum(steps)])
        corners = np.linspace(0.0, run[-1], max(2, round(run[-1] / SPACING) + 1))
        polyline = np.stack([np.interp(corners, run, way[:, axis]) for axis in range(3)], axis=1)
        try:
            opened = self.scene.simulation.prepared_cut(polyline, -self._outward[copy], float(np.median(way[:, 3])))
        except UserError:  # a way that comes back to itself, or is too shallow
            return -MISSED, False
        fine = np.stack([np.interp(np.linspace(0, 1, 50), np.linspace(0, 1, len(corners)), one) for one in polyline.T])
        apart = np.linalg.norm(self._across(copy, (self._lines()[copy][:, None] - fine.T).reshape(-1, 3)), axis=1)
        apart = apart.reshape(SAMPLES, -1)
        beside = max(float(apart.min(axis=0).mean()), float(apart.min(axis=1).mean()))
        wrong = abs(opened.cuts[-1].depth - self._wanted[copy]) / self._wanted[copy]
        pressed = max(0.0, self._peak[copy] / MOST_FORCE - 1.0)
        worth = DECLARED * float(np.clip(1.0 - beside / LINE - wrong / DEPTH - pressed, -0.1, 1.0))
        return worth, bool(beside < GOOD_LINE and wrong < GOOD_DEPTH and pressed == 0.0)


def copies_of(task: str, count: int, organ: Organ | str | None = None, threads: int = 0) -> TaskCopies:
    """Return copies of a task; parameters are those of TaskCopies."""
    return (CutCopies if task == "Cut" else TaskCopies)(task, count, organ, threads)
