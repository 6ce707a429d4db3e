"""Thickness of the tissue around a cut: beyond its front, which bounds the advance of that, and of its lips."""

from __future__ import annotations

import numpy as np

from tissue_sim.array_types import Floats
from tissue_sim.model.cutting.sheet import MAX_DEPTH, SAMPLES, Ligament, Sheet
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.surfaces.line_hits import line_hits
from tissue_sim.organ.surfaces.sizing import mean_edge
from tissue_sim.organ.winding import inside

SLANT = 0.5**0.5  # cosine of the angle between the two lines along which tissue beyond an end is measured
MAX_SAMPLES = 1000  # places along a front at which the tissue beyond it is measured
AT_ONCE = 32  # lines through all triangles, which limits the memory that they take
LIP_SAMPLES = 8  # places along a sheet, and as many below each, at which the thickness of its lips is computed


def with_ligament(organ: Organ, sheet: Sheet) -> Sheet:
    """Return a sheet that knows how much tissue there is beyond it; itself where it does already.

    Beyond an end, tissue is measured along it, straight and on a slant into the organ, and the larger thickness counts:
    beside a surface that is flat or curved there is little straight ahead.

    Parameters
    ----------
    organ : Organ
        The organ.
    sheet : Sheet
        The cut.
    """
    if sheet.ligament is not None:
        return sheet
    flat, begins = sheet.flat, sheet.begins
    spacing = mean_edge(organ.surface_positions, organ.surface_triangles) / SAMPLES
    lowest = float((organ.surface_positions @ sheet.direction).max() - (sheet.polyline @ sheet.direction).min())
    along, deep = (
        np.linspace(0.0, far, int(np.ceil(min(far / spacing, MAX_SAMPLES))) + 1)
        for far in (begins[-1], min(sheet.depth, max(lowest, spacing)))
    )
    front = sheet.top(along) + np.interp(along, begins, sheet.depths)[:, None] * sheet.direction
    ends = []
    for corner, (last, other) in ((sheet.polyline[0], flat[:2]), (sheet.polyline[-1], flat[:-3:-1])):
        outward = (last - other) / np.linalg.norm(last - other) @ sheet.frame
        points = corner + deep[:, None] * sheet.direction
        straight, slanted = _tissue_beyond(organ, points, outward, SLANT * (outward + sheet.direction))
        ends.append(np.maximum(straight, SLANT * slanted))
    (below,) = _tissue_beyond(organ, front, sheet.direction)
    return sheet._replace(ligament=Ligament(along, below, deep, *ends))


def _tissue_beyond(organ: Organ, points: Floats, *directions: Floats) -> Floats:
    """Return how far it is from points (k, 3) m along each of d directions to the surface, (d, k) m.

    MAX_DEPTH outside.
    """
    found = np.full((len(directions), len(points)), MAX_DEPTH)
    within = np.flatnonzero(inside(points, organ.surface_positions, organ.surface_triangles))
    for part in np.split(within, range(AT_ONCE, len(within), AT_ONCE)):
        for row, direction in zip(found, directions, strict=True):
            where = line_hits(organ, points[part], direction)
            row[part] = np.where(where > 0.0, where, MAX_DEPTH).min(axis=1)
    return found


def lip_thickness(organ: Organ, sheet: Sheet) -> float:
    """Return the thickness, m, of the thinner lip of a cut: across the sheet, from there to the surface.

    It is the median over the part of the sheet that lies in tissue; infinite where none does.

    Parameters
    ----------
    organ : Organ
        The organ.
    sheet : Sheet
        The cut.
    """
    begins = sheet.begins
    middle = (np.arange(LIP_SAMPLES) + 0.5) / LIP_SAMPLES
    along = middle * begins[-1]
    below = np.outer(np.interp(along, begins, sheet.depths), middle)
    points = sheet.top(along)[:, None] + below[:, :, None] * sheet.direction
    within = inside(points.reshape(-1, 3), organ.surface_positions, organ.surface_triangles)
    segment = np.searchsorted(begins, along, side="right") - 1
    thick = [np.zeros((0, 2))]
    for place, rows, (run_x, run_y) in zip(
        points, within.reshape(-1, LIP_SAMPLES), np.diff(sheet.flat, axis=0)[segment], strict=True
    ):
        normal = np.array([-run_y, run_x]) @ sheet.frame
        where = line_hits(organ, place[rows], normal / np.linalg.norm(normal))
        ahead, behind = np.where(where > 0.0, where, np.inf), np.where(where < 0.0, -where, np.inf)
        thick.append(np.stack([ahead.min(axis=1), behind.min(axis=1)], axis=1))
    found = np.concatenate(thick)
    return float(np.median(found, axis=0).min()) if len(found) else float("inf")
