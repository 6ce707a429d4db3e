"""Path of the blade of Cut in the organ at rest, and the distance of a cut along it from the line.

Copies of a batch and a tool over ROS use the same.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tissue_sim.array_types import Floats, Mask
from tissue_sim.environments.tasks import DECLARED, STEP, TOUCH

BLADE_SPEED, LONGEST_BLADE = 0.05, 0.02  # m/s at an action of 1; m
APART, SPACING = 5e-4, 0.005  # m between noted points of a path, and between corners of the cut
SHORTEST = 0.004  # m, below which a path is not a cut
SAMPLES, REACH = 21, 0.003  # points of the line, and m from the path within which one is cut
LINE, DEPTH = 0.005, 0.5  # m beside the line, and part of the depth, at which a cut is worth nothing
GOOD_LINE, GOOD_DEPTH, MOST_FORCE = 0.002, 0.15, 1.0  # of a success: m, part of the depth, N of the guard at most


class Line(NamedTuple):
    """The line of a cut at rest, in m: its middle on the surface, from there to an end, the normal, and the depth."""

    middle: Floats  # (3,)
    half: Floats  # (3,)
    outward: Floats  # (3,)
    wanted: float

    def points(self) -> Floats:
        """Return points (SAMPLES, 3) m of it."""
        return np.asarray(self.middle + np.linspace(-1.0, 1.0, SAMPLES)[:, None] * self.half)

    def across(self, vectors: Floats) -> Floats:
        """Return vectors (k, 3) as they are seen along the normal."""
        return np.asarray(vectors - np.outer(vectors @ self.outward, self.outward))


class PlannedCut(NamedTuple):
    """A cut along a path."""

    polyline: Floats  # (m, 3) m
    depth: float  # m


class MadeCut(NamedTuple):
    """Errors of a cut, and its reward."""

    beside: float  # m from the line, on average
    off: float  # error of its depth, as a part of the depth
    pressed: float  # force above MOST_FORCE, as a part of that

    @property
    def worth(self) -> float:
        """Reward."""
        return DECLARED * float(np.clip(1.0 - self.beside / LINE - self.off / DEPTH - self.pressed, -0.1, 1.0))

    @property
    def is_good(self) -> bool:
        """True where the goal is met."""
        return bool(self.beside < GOOD_LINE and self.off < GOOD_DEPTH and self.pressed == 0.0)


def moved_blade(blade: Floats, actions: Floats) -> Floats:
    """Return how far blades (n,) m protrude after a step with the clipped actions (n, 5)."""
    return np.clip(blade + STEP * BLADE_SPEED * actions[:, 3], 0.0, LONGEST_BLADE)


class BladePath:
    """Path of a blade through the tissue, in the organ at rest, and the points of the line that it has cut.

    Parameters
    ----------
    line : Line
        The line that is to be cut.
    """

    def __init__(self, line: Line) -> None:
        self.line, self.points = line, list[Floats]()  # (4,) m: where, and how deep
        self.peak = 0.0  # N, of the guard
        self.is_cut: Mask = np.zeros(SAMPLES, dtype=np.bool_)

    def note(self, tip: Floats, blade: float, force: float, surface: Floats, rest: tuple[Floats, Floats]) -> None:
        """Note where a blade is, if it is in the tissue.

        Parameters
        ----------
        tip : Floats, shape (3,), m
            Middle of the guard.
        blade : float, m
            How far the blade protrudes.
        force : float, N
            On the guard.
        surface : Floats, shape (n, 3), m
            Surface points.
        rest : tuple[Floats, Floats], shapes (n, 3) m and (n, 3)
            These at rest, and their normals.
        """
        self.peak = max(self.peak, force)
        if force <= TOUCH or blade <= 0.0:
            return
        at_rest, normals = rest
        node = int(np.argmin(np.linalg.norm(surface - tip, axis=1)))
        # The guard dents the tissue between the nodes, too: its place on the surface at rest is what counts.
        point = tip - (surface[node] - at_rest[node])
        point -= ((point - at_rest[node]) @ normals[node]) * normals[node]
        if not self.points or np.linalg.norm(point - self.points[-1][:3]) >= APART:
            self.points.append(np.append(point, blade))
        self.is_cut |= np.linalg.norm(self.line.across(self.line.points() - point), axis=1) < REACH

    def away(self, tip: Floats) -> float:
        """Return how far a tip (3,) m is from what is left of the line, m."""
        left = self.line.points()[~self.is_cut]
        return float(np.linalg.norm(left - tip, axis=1).min()) if len(left) else 0.0

    def planned(self) -> PlannedCut | None:
        """Return the cut along the path, as deep as the blade protruded on average; None where it is too short."""
        path = np.array(self.points).reshape(-1, 4)
        steps = np.linalg.norm(np.diff(path[:, :3], axis=0), axis=1)
        if steps.sum() < SHORTEST:
            return None
        run = np.concatenate([[0.0], np.cumsum(steps)])
        corners = np.linspace(0.0, run[-1], max(2, round(run[-1] / SPACING) + 1))
        polyline = np.stack([np.interp(corners, run, path[:, axis]) for axis in range(3)], axis=1)
        return PlannedCut(polyline, float(np.median(path[:, 3])))

    def judge(self, cut: PlannedCut, depth: float) -> MadeCut:
        """Return the errors of a cut.

        Parameters
        ----------
        cut : PlannedCut
            The cut.
        depth : float, m
            Its depth, as the organ's report has it.
        """
        line, corners = self.line, np.linspace(0, 1, len(cut.polyline))
        fine = np.stack([np.interp(np.linspace(0, 1, 50), corners, one) for one in cut.polyline.T])
        apart = np.linalg.norm(line.across((line.points()[:, None] - fine.T).reshape(-1, 3)), axis=1)
        apart = apart.reshape(SAMPLES, -1)
        beside = max(float(apart.min(axis=0).mean()), float(apart.min(axis=1).mean()))
        off = abs(depth - line.wanted) / line.wanted
        return MadeCut(beside, off, max(0.0, self.peak / MOST_FORCE - 1.0))
