"""A closed surface whose edges are shorter in some places: long ones are split there, and points relax between."""

from __future__ import annotations

import numpy as np

from tissue_sim.array_types import Floats, Ints
from tissue_sim.errors import UserError
from tissue_sim.organ.surfaces.fitting import flip, settle
from tissue_sim.organ.surfaces.intersections import intersecting_pairs
from tissue_sim.organ.surfaces.resample import split_long
from tissue_sim.organ.surfaces.sizing import Wanted, mean_edge
from tissue_sim.organ.surfaces.surface import Wall
from tissue_sim.organ.surfaces.transport import relax_sized, transport_sized

_LONG = 4.0 / 3.0  # an edge is split when it is so many times as long as wanted: the halves are then nearer to it
_FINER = 0.95  # of the edges that are there: where more is wanted, nothing is split
_ROUNDS = 12  # of splitting; a round halves edges
_FRACTION = 0.25  # of the points that a round adds at most
_EVEN = 16  # steps of relaxation at the end


def graded(positions: Floats, triangles: Ints, wall: Wall, wanted: Wanted, most: int) -> tuple[Floats, Ints]:
    """Add points to a surface where shorter edges are wanted, and lay it on the wall.

    Parameters
    ----------
    positions : points on the wall's grid, evenly spaced, (n, 3) mm
    triangles : outward, (t, 3)
    wall : that the surface lies on
    wanted : edge lengths wanted at points, mm; longer ones than the surface has change nothing
    most : points of the result at most

    Returns
    -------
    positions, triangles : of the graded surface

    Raises
    ------
    UserError
        when it would have more than `most` points

    """
    edge = mean_edge(positions, triangles)
    found = _split(positions, triangles, wall, wanted, edge, most)
    size = np.minimum(wanted(found[0]), edge)
    laid = found[0].copy(), found[1].copy()
    settle(*laid, wall, size=size)
    for surface in (laid, found):
        if not len(intersecting_pairs(*surface)):
            return surface
    # In a fold that the balloon left out, points that are laid on the wall would cross it: they stay in its triangles.
    return _split(positions, triangles, None, wanted, edge, most)


def split_in_place(positions: Floats, triangles: Ints, wanted: Wanted, most: int) -> tuple[Floats, Ints]:
    """Add points to a surface where shorter edges are wanted, in the middles of edges: its shape stays exactly.

    Parameters
    ----------
    positions : points, evenly spaced, (n, 3)
    triangles : outward, (t, 3)
    wanted : edge lengths wanted at points, in their unit; longer ones than the surface has change nothing
    most : points of the result at most

    Returns
    -------
    positions, triangles : of the new surface, the points before first

    Raises
    ------
    UserError
        when it would have more than `most` points

    """
    return _split(positions, triangles, None, wanted, mean_edge(positions, triangles), most)


def _split(
    positions: Floats, triangles: Ints, wall: Wall | None, wanted: Wanted, edge: float, most: int
) -> tuple[Floats, Ints]:
    """Split edges until none is much longer than wanted; without a wall, points stay where they came to lie."""
    positions, triangles = positions.copy(), np.ascontiguousarray(triangles)
    for _ in range(_ROUNDS):
        n = len(positions)
        size = np.minimum(wanted(positions), edge)
        finer = np.where(size < _FINER * edge, size, np.inf)
        positions, triangles = split_long(positions, triangles, finer, _LONG, max(int(_FRACTION * n), 1))
        if len(positions) == n:
            break
        if len(positions) > most:
            raise UserError(f"--refine asks for more than {most} points; refine a smaller part, or to longer edges")
        _relax(positions, triangles, wall, wanted, edge, 2)
    _relax(positions, triangles, wall, wanted, edge, _EVEN)
    return positions, triangles


def _relax(positions: Floats, triangles: Ints, wall: Wall | None, wanted: Wanted, edge: float, steps: int) -> None:
    """Even out a surface towards the edges wanted, in place: move points to wide places, flip edges, relax."""
    if wall is None:
        return
    for step in range(steps):
        size = np.minimum(wanted(positions), edge)
        if step % 4 == 2:
            transport_sized(positions, triangles, 2.0, max(len(positions) // 50, 1), size.copy())
            size = np.minimum(wanted(positions), edge)
        flip(positions, triangles)
        relax_sized(positions, triangles, 0.4, size)
        positions[:] = wall.project(positions, 1)
