"""The sheet that a blade sweeps: a polyline moved along a direction, in the organ's rest coordinates."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from tissue_sim.arguments import finite, floats_of
from tissue_sim.array_types import Floats, Mask
from tissue_sim.directions import across
from tissue_sim.errors import UserError
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.polyline import arc_length
from tissue_sim.organ.refinement import Along, Refinement, points_with
from tissue_sim.organ.surfaces.line_hits import line_hits
from tissue_sim.organ.surfaces.sizing import local_edges, mean_edge
from tissue_sim.organ.tool_resolution import CUT_EDGES
from tissue_sim.organ.winding import inside

MAX_CORNERS = 1000  # of a polyline
MAX_DEPTH = 10.0  # m
# Depth in mean edges of the surface, below which a cut is refused: the front is moved by about as much.
MIN_DEPTH = 0.5
NEAR = 1.5  # mean edges from a sheet within which the surface's edges are those at the cut
FINER_WITHIN = 1.5  # mean edges around a cut within which a finer surface is proposed
MAX_REPORTED = 8  # points of a polyline in a message
SAMPLES = 4  # points of the polyline per mean edge, at which its depth below the surface is computed
# Parts of the tissue beyond an end of the sheet, and below it, by which the front is moved there at most: the rest
# holds both sides together. Below, it is a hinge, which bends easily.
PART_BESIDE, PART_BELOW = 0.5, 0.75
CLOSEST = 2.0  # mean edges, least distance between different parts of a polyline

Each = float | Floats  # for all points, or for each


class Place(NamedTuple):
    """Places of k points relative to a sheet."""

    across: Floats  # (k,) m, signed distance from the sheet, which is continued straight beyond its ends
    along: Floats  # (k,) m along the polyline; negative before its beginning, larger than its length after its end
    below: Floats  # (k,) m from the polyline along the direction


class Coagulation(NamedTuple):
    """Effect of a tool's heat on the tissue at the walls of its cut."""

    stiffening: float = 1.0  # factor on its moduli; 1: none, as a cold blade's
    spread: float = 0.0  # m from the cut that the heat reaches


class Ligament(NamedTuple):
    """Thickness of the tissue beyond a sheet, as far as the surface; MAX_DEPTH where its front is not in tissue.

    k places along the sheet, j of each end.
    """

    along: Floats  # (k,) m along the polyline
    below: Floats  # (k,) m, of the tissue below the sheet
    deep: Floats  # (j,) m from the polyline along the direction
    before: Floats  # (j,) m, of the tissue before its beginning
    after: Floats  # (j,) m, and after its end


class Sheet(NamedTuple):
    """Ruled surface between a polyline and the same polyline moved by the depth along a direction."""

    polyline: Floats  # (m, 3) m
    direction: Floats  # (3,) unit vector
    depth: float  # m
    rise: float  # m by which it is continued against the direction, so that it opens the surface
    frame: Floats  # (2, 3) axes of the plane across the direction
    reached: float  # m, largest depth of its end below the surface
    depths: Floats  # (m,) m, of each corner of the polyline, and linear between them
    mark: int = 0  # number of the blade's cut of which it is a stage; 0: not made by a blade
    coagulation: Coagulation = Coagulation()
    ligament: Ligament | None = None  # None: not yet known

    @property
    def flat(self) -> Floats:
        """The polyline's corners (m, 2) m in the plane across the direction."""
        flat: Floats = self.polyline @ self.frame.T
        return flat

    @property
    def begins(self) -> Floats:
        """The places of the polyline's corners along it, (m,) m; the last one is its length."""
        return arc_length(self.flat)

    def top(self, along: Floats) -> Floats:
        """Return the points (k, 3) m of the polyline at places along it, (k,) m."""
        begins = self.begins
        return np.stack([np.interp(along, begins, self.polyline[:, axis]) for axis in range(3)], axis=1)

    def place(self, points: Floats) -> Place:
        """Return the places of points relative to the sheet.

        Parameters
        ----------
        points : Floats, shape (k, 3), m
            The points.
        """
        corner = self.flat
        start, edge = corner[:-1], np.diff(corner, axis=0)
        length = np.linalg.norm(edge, axis=1)
        unit = edge / length[:, None]
        offset = (points @ self.frame.T)[:, None, :] - start
        run = np.einsum("kmx,mx->km", offset, unit)
        # The first and the last segment are continued, so that points before and behind the cut have a side, too.
        least = np.where(np.arange(len(unit)) == 0, -np.inf, 0.0)
        most = np.where(np.arange(len(unit)) == len(unit) - 1, np.inf, length)
        held = np.clip(run, least, most)
        away = offset - held[:, :, None] * unit
        nearest = np.argmin(np.einsum("kmx,kmx->km", away, away), axis=1)
        row = np.arange(len(points))
        run, away = held[row, nearest], away[row, nearest]
        normal = np.stack([-unit[:, 1], unit[:, 0]], axis=1)
        # At a corner, the mean normal of both segments determines the side (Baerentzen and Aanaes 2005).
        before, after = np.maximum(nearest - 1, 0), np.minimum(nearest + 1, len(unit) - 1)
        facing = normal[nearest]
        facing = facing + np.where((run <= least[nearest])[:, None], normal[before], 0.0)
        facing = facing + np.where((run >= most[nearest])[:, None], normal[after], 0.0)
        side = np.where(np.einsum("kx,kx->k", away, facing) < 0.0, -1.0, 1.0)
        begins = np.concatenate([[0.0], np.cumsum(length)])
        along = begins[nearest] + run
        top = np.interp(along, begins, self.polyline @ self.direction)
        return Place(side * np.linalg.norm(away, axis=1), along, points @ self.direction - top)

    def covers(self, place: Place, more: float = 0.0) -> Mask:
        """Return which of the points on the sheet or its continuation are on the sheet itself.

        Parameters
        ----------
        place : Place
            Where the points lie.
        more : float, m, optional
            Distance by which its front is moved.
        """
        return self._covers(place, more, more, more)

    def covers_advanced(self, place: Place, advance: float) -> Mask:
        """Return which of the points are on the sheet itself, with its front moved into the tissue.

        Where little tissue is left beyond the front, it is moved by a part of that, so that both sides hang together.

        Parameters
        ----------
        place : Place
            Where the points lie.
        advance : float, m
            Distance by which the front is moved elsewhere.
        """
        if self.ligament is None:
            return self.covers(place, advance)
        along, below, deep, before, after = self.ligament
        before, after = (np.minimum(PART_BESIDE * each, advance) for each in (before, after))
        below = np.minimum(PART_BELOW * below, advance)
        return self._covers(
            place,
            np.interp(place.below, deep, before),
            np.interp(place.below, deep, after),
            np.interp(place.along, along, below),
        )

    def _covers(self, place: Place, before: Each, after: Each, below: Each) -> Mask:
        """Return which points are covered by the sheet and so much more, m: before, after and below it."""
        begins = self.begins
        within = (place.along >= -before) & (place.along <= begins[-1] + after)
        depth = np.interp(place.along, begins, self.depths)
        covered: Mask = within & (place.below >= -self.rise) & (place.below <= depth + below)
        return covered

    def nearest(self, place: Place, margin: float) -> Floats:
        """Return the points (k, 3) m of the sheet nearest to places on its continuation, measured along it.

        Parameters
        ----------
        place : Place
            The places.
        margin : float, m
            Their distance from the sheet's edge.
        """
        length = self.begins[-1]
        top = self.top(np.clip(place.along, min(margin, 0.5 * length), max(length - margin, 0.5 * length)))
        found: Floats = top + np.clip(place.below, -self.rise, max(self.depth - margin, 0.0))[:, None] * self.direction
        return found

    def edge_at(self, organ: Organ) -> float:
        """Return the mean length, m, of the surface's edges at the cut.

        Parameters
        ----------
        organ : Organ
            The organ.
        """
        positions, triangles = organ.surface_positions, organ.surface_triangles
        edge = mean_edge(positions, triangles)
        place = self.place(positions)
        near = (np.abs(place.across) < NEAR * edge) & self.covers(place, 0.5 * edge)
        return float(local_edges(positions, triangles)[near].mean()) if near.any() else edge

    def deepens(self, other: Sheet) -> bool:
        """Return whether the sheet continues another one to the same or a greater depth, or by the same blade."""
        if self.mark or other.mark:
            return self.mark == other.mark
        return (
            self.polyline.shape == other.polyline.shape
            and bool(np.array_equal(self.polyline, other.polyline))
            and bool(np.array_equal(self.direction, other.direction))
            and self.depth >= other.depth
        )


def sheet_of(organ: Organ, polyline: ArrayLike, direction: ArrayLike, depth: float) -> Sheet:
    """Return the sheet of a cut.

    Parameters
    ----------
    organ : Organ
        The organ.
    polyline : ArrayLike, shape (m, 3), m
        Where the blade's edge begins, on the surface or above it: two points or more.
    direction : ArrayLike, shape (3,)
        Direction in which it is moved; of any length.
    depth : float, m
        Distance by which it is moved.

    Raises
    ------
    UserError
        For numbers that are not finite or out of range, a polyline along the direction, of no length or too close to
        itself, one that begins deep inside, and a cut that misses the organ or hardly scratches it.
    """
    corners = floats_of(polyline)
    if corners.ndim != 2 or corners.shape[1:] != (3,) or not 2 <= len(corners) <= MAX_CORNERS:
        raise UserError(f"the cut's polyline has shape {corners.shape}, expected (m, 3) with m from 2 to {MAX_CORNERS}")
    if not np.all(np.isfinite(corners)):
        raise UserError("the cut's polyline contains values that are not finite")
    way, far = finite(direction, 3, "the cut's direction"), float(finite([depth], 1, "the cut's depth")[0])
    if not 0.0 < far <= MAX_DEPTH:
        raise UserError(f"the cut's depth is {far:g} m, outside 0..{MAX_DEPTH:g}")
    size = float(np.linalg.norm(way))
    if not 1e-9 < size < 1e9:
        raise UserError("the cut's direction has no length")
    way = way / size
    frame = across(way)
    corners = np.array(corners)
    step = np.linalg.norm(np.diff(corners @ frame.T, axis=0), axis=1)
    edge = mean_edge(organ.surface_positions, organ.surface_triangles)
    if np.any(step < 1e-6 * edge):
        raise UserError("two points of the cut's polyline lie on each other, or behind each other in its direction")
    _check_apart(corners @ frame.T, step, CLOSEST * edge)
    rise, reached = heights(organ, _samples(corners, step, edge / SAMPLES), way, far)
    if reached <= 0.0:
        raise UserError(f"the cut misses organ '{organ.name}', or ends above its surface")
    if rise > max(far, CUT_EDGES * edge):
        raise UserError(
            f"the cut's polyline begins {1e3 * rise:.3g} mm inside organ '{organ.name}'; begin on its surface"
        )
    found = Sheet(corners, way, far, rise + edge, frame, reached, np.full(len(corners), far))
    here = found.edge_at(organ)
    if reached < MIN_DEPTH * here:
        raise UserError(
            f"a cut {1e3 * reached:.2g} mm deep is too shallow for a surface with edges of {1e3 * here:.2g} mm;"
            f" cut at least {1e3 * MIN_DEPTH * here:.2g} mm deep, or {finer_organ(organ, found)}"
        )
    return found


def finer_organ(organ: Organ, sheet: Sheet, lip: float = float("inf")) -> str:
    """Return the text of a command that makes an organ which resolves a cut, and of its cost.

    Parameters
    ----------
    organ : Organ
        The organ.
    sheet : Sheet
        The cut.
    lip : float, m, optional
        Thickness of its thinner lip.
    """
    positions, triangles = organ.surface_positions, organ.surface_triangles
    edge = mean_edge(positions, triangles)
    wanted, radius = min(sheet.reached, lip) / CUT_EDGES, FINER_WITHIN * edge
    place = sheet.place(positions)
    near = (np.abs(place.across) < NEAR * edge) & sheet.covers(place, 0.5 * edge)
    sunk = float(np.median(place.below[near])) if near.any() else 0.0
    corners = sheet.polyline[
        np.linspace(0, len(sheet.polyline) - 1, min(len(sheet.polyline), MAX_REPORTED)).astype(int)
    ]
    line = corners + sunk * sheet.direction
    count = points_with(Refinement(places=(Along(line, radius, wanted),)), positions, triangles, organ.fixed)
    along = "/".join(",".join(f"{1e3 * value:.1f}" for value in point) for point in line)
    return (
        f"make a finer organ by tissue_sim calibrate ORGAN --refine={along}:{1e3 * radius:.1f}:{1e3 * wanted:.1f} --out"
        f" FINER (about {count} points in place of {len(positions)}, and ticks {count / len(positions):.1f} times as"
        " long)"
    )


def _samples(corners: Floats, step: Floats, spacing: float) -> Floats:
    """Return points (k, 3) on a polyline, at most `spacing` apart."""
    parts = [np.ceil(length / spacing).clip(1, 1000).astype(int) for length in step]
    pieces = [
        first + np.arange(count)[:, None] / count * (last - first)
        for first, last, count in zip(corners[:-1], corners[1:], parts, strict=True)
    ]
    return np.concatenate([*pieces, corners[-1:]])


def _check_apart(flat: Floats, step: Floats, least: float) -> None:
    """Refuse a polyline that comes so close to itself that cells would be crossed twice."""
    points = _samples(flat, step, 0.25 * least)
    begins = arc_length(points)
    between = np.linalg.norm(points[:, None] - points[None], axis=2)
    apart = np.abs(begins[:, None] - begins[None]) > 2.0 * least
    if np.any(apart & (between < least)):
        raise UserError(f"the cut's polyline comes closer than {1e3 * least:.2g} mm to another part of itself")


def heights(organ: Organ, points: Floats, direction: Floats, depth: float | Floats) -> tuple[float, float]:
    """Return the largest depth of a polyline inside the organ, and of the end of its cut below the surface, m.

    Parameters
    ----------
    organ : Organ
        The organ.
    points : Floats, shape (k, 3), m
        Points of the polyline.
    direction : Floats, shape (3,)
        Unit direction of the cut.
    depth : float | Floats, shape (k,), m
        Distance by which it is moved, for all points or for each.
    """
    where = line_hits(organ, points, direction)  # comparisons with NaN, for a miss, are false
    before = np.where(where <= 0.0, where, -np.inf).max(axis=1)
    after = np.where(where > 0.0, where, np.inf).min(axis=1)
    last = np.where(np.isnan(where), -np.inf, where).max(axis=1)
    within = inside(points, organ.surface_positions, organ.surface_triangles)
    top = np.where(within, before, after)
    good = np.isfinite(top)
    if not good.any():
        return 0.0, 0.0
    reached = np.minimum(np.broadcast_to(depth, len(points))[good], last[good]) - top[good]
    return float(np.where(within & good, -top, 0.0)[good].max()), float(reached.max())
