"""Path of a blade in an organ at rest, and the sheet that it has swept."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from tissue_sim.array_types import Floats
from tissue_sim.directions import across
from tissue_sim.errors import UserError
from tissue_sim.model.cutting.sheet import MIN_DEPTH, Coagulation, Sheet, heights
from tissue_sim.organ.normals import surface_normals
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.surfaces.line_hits import line_hits
from tissue_sim.organ.surfaces.sizing import mean_edge
from tissue_sim.organ.tool_resolution import CUT_EDGES

BIN_WIDTH = 0.5  # mean edges of the surface; the length of a cut is divided into such bins
MIN_NORMAL_COSINE = 0.3  # between a blade's plane and the surface's normal; below it the cut follows the edge instead
NEAR = 0.1  # mean edges within which places count as on the surface
SCISSORS_GAP = 0.2  # mean edges between the blades of scissors, below which the tissue between them counts as cut
MIN_PLANE_COSINE = 0.9  # between the planes of a blade and of a cut that it continues
GROWTH = 0.35  # mean edges by which a cut must grow before it is opened again


class _Extent(NamedTuple):
    """Extent of a cut when its sheet was made."""

    deepest: dict[int, float]  # m, by bin
    ends: tuple[float, float]  # m along the cut
    through: int  # bins in which both blades of scissors had passed each other


class BladePath:
    """Places that the edge of one blade has passed in an organ, and the sheet through them.

    The sheet is ruled along one direction: into the organ, in the plane of the blade where it entered. Across that it
    follows the blade, and its depth at each place of its length is the largest one reached. A blade that turns back, or
    by more than a right angle, needs another path.

    Parameters
    ----------
    organ : Organ
        The organ, uncut.
    mark : int
        Number of the cut, by which later sheets of the same cut replace earlier ones.
    """

    def __init__(self, organ: Organ, mark: int) -> None:
        self._organ, self._mark = organ, mark
        self._edge = mean_edge(organ.surface_positions, organ.surface_triangles)
        self._size = float(np.linalg.norm(np.ptp(organ.surface_positions, axis=0)))  # m, more than it is thick
        self._axes: Floats | None = None  # (3, 3) along the cut, into the organ, and across both
        self._deepest: dict[int, float] = {}  # m, by bin
        self._aside: dict[int, float] = {}  # m
        self._coagulation = Coagulation()  # of the hottest tool that has been in it
        self._met: set[int] = set()  # bins in which both blades of scissors have passed each other
        self._ends = (np.inf, -np.inf)  # m along the cut
        # Extents of the last sheet, and of the last one that was opened, since the organ may refuse a sheet.
        self._made = self._opened = _Extent({}, (np.inf, -np.inf), 0)

    def note(self, places: Floats, forward: Floats, along: Floats) -> None:
        """Add the present place of the edge.

        Parameters
        ----------
        places : Floats, shape (k, 3), m
            Places on it, at rest.
        forward : Floats, shape (3,)
            Direction in which it cuts, at rest.
        along : Floats, shape (3,)
            Direction of the edge, at rest.
        """
        if self._axes is None:
            self._axes = self._frame(places, forward, along)
        length, depth, aside = self._axes @ places.T
        self._ends = min(self._ends[0], float(length.min())), max(self._ends[1], float(length.max()))
        order, size = np.argsort(length), BIN_WIDTH * self._edge
        bins = np.floor(length / size).astype(int)
        for number in range(bins[order[0]], bins[order[-1]] + 1):
            within = bins == number
            # Between two places, the edge is a straight line.
            middle = (number + 0.5) * size
            deep = float(depth[within].max()) if within.any() else float(np.interp(middle, length[order], depth[order]))
            off = float(aside[within].mean()) if within.any() else float(np.interp(middle, length[order], aside[order]))
            if deep > self._deepest.get(number, -np.inf):
                self._deepest[number] = deep
                self._aside.setdefault(number, off)

    def heat(self, coagulation: Coagulation) -> None:
        """Add the heat of a tool in the cut: later sheets have the walls of the tool that stiffens them most.

        Parameters
        ----------
        coagulation : Coagulation
            Effect of the tool's heat on the walls.
        """
        self._coagulation = max(self._coagulation, coagulation)

    def meet(self, places: Floats) -> None:
        """Add the place of the other edge of scissors: where both have passed each other, the tissue is cut.

        Parameters
        ----------
        places : Floats, shape (k, 3), m
            Places on it, at rest.
        """
        if self._axes is None:
            return
        length, depth, _ = self._axes @ places.T
        order, size = np.argsort(length), BIN_WIDTH * self._edge
        for number, deep in self._deepest.items():
            middle = (number + 0.5) * size
            if length.min() <= middle <= length.max():
                other = float(np.interp(middle, length[order], depth[order]))
                if other - deep < SCISSORS_GAP * self._edge:
                    self._met.add(number)

    def _frame(self, places: Floats, forward: Floats, along: Floats) -> Floats:
        """Return the axes (3, 3) of a cut that begins at some places."""
        surface = self._organ.surface_positions
        away, nearest = cKDTree(surface).query(places)
        normals = surface_normals(surface, self._organ.surface_triangles)[nearest]
        # Mostly the surface's normal at the place nearest to the edge, or the mean of both sides of a sharp edge.
        inward = -normals.T @ (1.0 / (away**2 + (NEAR * self._edge) ** 2))
        inward /= max(float(np.linalg.norm(inward)), 1e-300)
        normal = np.cross(along, forward)
        normal /= np.linalg.norm(normal)
        into = inward - (inward @ normal) * normal
        size = float(np.linalg.norm(into))
        into = into / size if size > MIN_NORMAL_COSINE else forward / np.linalg.norm(forward)
        return np.stack([np.cross(into, normal), into, normal])

    def continues(self, places: Floats, forward: Floats, along: Floats) -> bool:
        """Return whether an edge that enters the organ is in this cut.

        Parameters
        ----------
        places : Floats, shape (k, 3), m
            Places on it, at rest.
        forward : Floats, shape (3,)
            Direction in which it cuts, at rest.
        along : Floats, shape (3,)
            Direction of the edge, at rest.
        """
        if self._axes is None:
            return False
        normal = np.cross(along, forward)
        if abs(normal @ self._axes[2]) < MIN_PLANE_COSINE * np.linalg.norm(normal):
            return False
        length, depth, aside = self._axes @ places.mean(axis=0)
        _, at, deepest, off = self._swept()
        beside = abs(aside - np.interp(length, at, off)) < self._edge
        deep = depth < np.interp(length, at, deepest) + self._edge
        within = self._ends[0] - self._edge < length < self._ends[1] + self._edge
        return bool(beside and deep and within)

    def _swept(self) -> tuple[list[int], Floats, Floats, Floats]:
        """Return the bins in order, and for each its middle along the cut, its depth and its lateral offset, m."""
        numbers = sorted(self._deepest)
        deep = np.array([self._deepest[number] for number in numbers])
        off = np.array([self._aside[number] for number in numbers])
        return numbers, (np.array(numbers) + 0.5) * BIN_WIDTH * self._edge, deep, off

    @property
    def has_grown(self) -> bool:
        """Whether the cut has grown enough since its last sheet to be opened again."""
        return self._growth(self._made) >= GROWTH * self._edge

    @property
    def is_open(self) -> bool:
        """Whether all of it has been opened, apart from rounding."""
        return self._growth(self._opened) < 0.25 * GROWTH * self._edge

    def _growth(self, since: _Extent) -> float:
        """Return the increase of the cut's depth or length, m."""
        if not self._deepest:
            return 0.0
        if not since.deepest:
            return float("inf")
        deepest, (first, last) = since.deepest, since.ends
        deeper = max(deep - deepest[number] for number, deep in self._deepest.items() if number in deepest)
        through = np.inf if len(self._met) > since.through else 0.0
        return max(deeper, first - self._ends[0], self._ends[1] - last, through)

    def note_opened(self) -> None:
        """Record that the organ was cut along the last sheet."""
        self._opened = self._made

    def sheet(self) -> Sheet:
        """Return the sheet that the blade has swept so far; see note_opened.

        Raises
        ------
        UserError
            While the cut is too shallow for the surface.
        """
        if self._axes is None:
            raise UserError("the blade has not been in the organ")
        size = BIN_WIDTH * self._edge
        numbers, along, deep, off = self._swept()
        along = np.clip(along, *self._ends)
        more = np.where([self._is_through(number) for number in numbers], self._size, 0.0)
        at = np.concatenate([[self._ends[0]], along, [self._ends[1]]])
        apart = np.concatenate([[True], np.diff(at) > 0.1 * size])
        apart[-1] = True
        if len(at) > 2 and not at[-1] - at[-2] > 0.1 * size:
            apart[-2] = False
        at = at[apart]
        deep, off, more = (np.interp(at, along, each) for each in (deep, off, more))
        if len(at) < 2 or at[-1] - at[0] < 0.1 * size:
            raise UserError("the cut has no length yet")
        first, into, normal = self._axes
        bottom = at[:, None] * first + deep[:, None] * into + off[:, None] * normal
        depth = self._below(bottom, into)
        corners = bottom - depth[:, None] * into
        depth = depth + more
        rise, reached = heights(self._organ, corners, into, depth)
        if reached < MIN_DEPTH * self._edge:
            raise UserError(
                f"the cut is {1e3 * max(reached, 0.0):.2g} mm deep, too shallow to open a surface with edges of"
                f" {1e3 * self._edge:.2g} mm"
            )
        self._made = _Extent(dict(self._deepest), self._ends, len(self._met))
        rise = min(rise, CUT_EDGES * self._edge) + self._edge
        far, frame = float(depth.max()), across(into)
        return Sheet(corners, into, far, rise, frame, reached, depth, self._mark, self._coagulation)

    def _is_through(self, number: int) -> bool:
        """Return whether scissors have cut through at a bin, or the uncut part beside it is less than an edge long."""
        beside = round(1.0 / BIN_WIDTH)
        return any(number + step in self._met for step in range(-beside, beside + 1))

    def _below(self, places: Floats, into: Floats) -> Floats:
        """Return the depths of places (k, 3) below the surface, m (k,), at least a fraction of an edge."""
        where = line_hits(self._organ, places, into)
        before = np.where(where <= 0.0, where, -np.inf).max(axis=1)
        depth = np.where(np.isfinite(before), -before, np.nan)
        if np.isnan(depth).all():
            return np.full(len(places), 0.1 * self._edge)
        known = np.flatnonzero(~np.isnan(depth))
        return np.maximum(np.interp(np.arange(len(depth)), known, depth[known]), 0.1 * self._edge)
