"""Cells that a sheet divides: the fraction on either side, and the fraction of the section that is cut."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import permutations
from typing import NamedTuple

import numpy as np

from tissue_sim.array_types import Floats, Ints, Longs, Mask
from tissue_sim.model.cutting.sheet import Place, Sheet
from tissue_sim.organ.edges import CELL_EDGES

# Mean edges of the crossed cells by which the front is moved, since the cells there are too stiff: they are too coarse
# for the stress. Chosen on three cuts of a kidney, and confirmed on two others (docs/cutting.md).
ADVANCE = 0.6
# Fraction of a cell's section that is cut, below which it counts as uncut, and above 1 minus which as cut through.
MIN_CUT = 0.02
# Least distance of every node from the sheet, in mean edges of the crossed cells, so that no fragment is a point.
MIN_HEIGHT = 0.02
# Largest distance of a cell's section from a sheet that bends, in edges of the cell; a cell with a larger one lies
# between two parts of the sheet.
MAX_BENDING = 0.5
# Largest distance of a front from its cut, relative to that from another cut in the same surface: half of the tissue
# between two cuts stays whole.
BRIDGE = 1.0 / 3.0
BETWEEN = 0.1  # cosine from which the directions to two cuts count as opposite; they are perpendicular in a corner
MARGIN = 0.1  # of the front's advance, within which it counts as ending at another cut
GRID = 12  # samples along each side of a section


class Crossing(NamedTuple):
    """Cells that a sheet divides. k cells, n nodes."""

    cells: Longs  # (k,) which they are, ascending
    cut_fraction: Floats  # (k,) of the section that is cut: 1, or less for cells at the front
    fraction: Floats  # (k,) of the volume on the positive side
    height: Floats  # (n,) m, of every node above the sheet; its sign is the side, and it is never 0
    area: float  # m^2, of the sheet within these cells, without the front's advance
    advance: float  # m by which the front was moved

    @property
    def positive(self) -> Mask:
        """Nodes (n,) on the positive side."""
        return self.height > 0.0


class Samples(NamedTuple):
    """Points on the sections of divided cells. k cells, g points on each."""

    coordinates: Floats  # (k, g, 4) barycentric ones in the cell
    weight: Floats  # (k, g) m^2, the area that each represents
    covered: Mask  # (k, g) whether the sheet reaches it, with the front's advance


class Earlier(NamedTuple):
    """Cells that an earlier stage of the same cut has divided. k cells, n nodes, g points on each section."""

    cells: Longs  # (k,) which they are, ascending
    height: Floats  # (n,) m, of every node above that stage's sheet
    covered: Mask  # (k, g) samples of each section that it has cut, with the front's advance


class Shared(NamedTuple):
    """Surface that a sheet has in common with others."""

    height: Floats  # (n,) m, of every node above it; never 0
    sheets: tuple[Sheet, ...]  # the others


def _sections() -> Longs:
    """Return the edges (16, 4, 2) of a cell that its section crosses, in order, by the sides of its corners.

    The row has a bit for each corner on the positive side. Each edge begins on that side, and the section's normal
    points to the other one. A section of three corners repeats the last.
    """
    found = np.zeros((16, 4, 2), dtype=np.int64)
    even = [order for order in permutations(range(4)) if _is_even(order)]
    for pattern in range(1, 15):
        up = [corner for corner in range(4) if pattern >> corner & 1]
        lone = up if len(up) == 1 else [corner for corner in range(4) if corner not in up]
        if len(up) == 2:
            a, b, c, d = next(order for order in even if {*order[:2]} == {*up})
            edges = [(a, c), (a, d), (b, d), (b, c)]
        else:
            a, b, c, d = next(order for order in even if order[0] == lone[0])
            edges = [(a, b), (a, c), (a, d)] if len(up) == 1 else [(d, a), (c, a), (b, a)]
            edges += edges[-1:]
        found[pattern] = edges
    return found


def _is_even(order: tuple[int, ...]) -> bool:
    return sum(order[i] > order[j] for i in range(4) for j in range(i)) % 2 == 0


SECTIONS = _sections()


def section_of(positive: Mask) -> Longs:
    """Return the edges (k, 4, 2) of cells that their sections cross, by the sides (k, 4) of their corners.

    Each is a pair of corners, of which the first is on the positive side; see _sections.
    """
    sections: Longs = SECTIONS[positive @ (1 << np.arange(4))]
    return sections


def fractions_of(height: Floats) -> Floats:
    """Return the fractions (k,) of cells' volumes where a linear function, given at the corners (k, 4), is positive.

    All terms are positive, so that small fractions are accurate too.
    """
    positive = height > 0.0
    count = positive.sum(axis=1)
    pairs = section_of(positive)
    row = np.arange(len(height))[:, None]
    first, second = height[row, pairs[:, :, 0]], height[row, pairs[:, :, 1]]
    reach = first / (first - second)  # of each crossed edge, the part on the positive side
    ac, ad, bd, bc = reach.T
    wedge = ac * ad + bc * bd * (1.0 - ac) + bd * ac * (1.0 - ad)
    away = 1.0 - reach[:, 0]
    for column in (1, 2):
        away = away * (1.0 - reach[:, column])
    fractions: Floats = np.where(count == 1, ac * ad * bd, np.where(count == 3, 1.0 - away, wedge))
    return fractions


def crossing_among(
    rest: Floats,
    cells: Ints | Longs,
    sheet: Sheet,
    others: Sequence[Sheet] = (),
    earlier: Earlier | None = None,
    shared: Shared | None = None,
) -> tuple[Crossing, Samples]:
    """Return the cells that a sheet divides in an organ that other sheets may cut, too.

    Heights above the sheet are linear in each cell, so that neighbours agree on where it crosses their common edges.

    The sheet of a blade that continues to cut differs slightly from that of its earlier stage: it turns with the blade,
    and its front is moved by another mean edge. Lips that are open can't close again, or change sides. So cells that
    the earlier stage has divided stay divided at the same place, and at least as far.

    Parameters
    ----------
    rest : Floats, shape (n, 3), m
        Rest positions of the nodes.
    cells : Ints | Longs, shape (c, 4)
        Node indices of the cells.
    sheet : Sheet
        The sheet.
    others : Sequence[Sheet], optional
        Sheets of other cuts, beyond which the front is not moved.
    earlier : Earlier | None, optional
        Of the same cut; None: there was none.
    shared : Shared | None, optional
        The surface in which other sheets lie, too; None: none does.

    Returns
    -------
    tuple[Crossing, Samples]
        The cells, none where the sheet passes between them, and samples of their sections.
    """
    across = sheet.place(rest).across if shared is None else shared.height
    held = np.zeros(0, dtype=np.int64) if earlier is None else np.unique(cells[earlier.cells])
    if earlier is not None and shared is None:
        across[held] = earlier.height[held]
    at = across[cells]
    near = np.flatnonzero((at.min(axis=1) <= 0.0) & (at.max(axis=1) >= 0.0))
    corner = rest[cells[near]]
    edges = np.stack([np.linalg.norm(corner[:, a] - corner[:, b], axis=1) for a, b in CELL_EDGES], axis=1).mean(axis=1)
    typical = float(edges.mean()) if len(edges) else 0.0
    least = MIN_HEIGHT * typical
    height = across
    if shared is None:
        height = np.where(np.abs(across) < least, np.copysign(least, across), across)
        height[held] = across[held]
    at = height[cells]
    crossed = np.flatnonzero((at.min(axis=1) < 0.0) & (at.max(axis=1) > 0.0))
    size = edges[np.searchsorted(near, crossed)]  # no other cell is crossed
    corners, weight = _section_samples(rest[cells[crossed]], at[crossed])
    middle = sheet.place(corners.mean(axis=1))
    real = np.abs(middle.across) < MAX_BENDING * size
    if earlier is not None:
        real |= np.isin(crossed, earlier.cells)
    crossed, corners, weight, size = crossed[real], corners[real], weight[real], size[real]
    points = corners.reshape(-1, 3)
    place = sheet.place(points)
    bare = (weight * sheet.covers(place).reshape(weight.shape)).sum(axis=1)
    cut = bare > 0.0
    advance = ADVANCE * float(size[cut].mean()) if cut.any() else 0.0
    reached = sheet.covers_advanced(place, advance) & ~_beyond(points, place, sheet, others, MARGIN * advance)
    if shared is not None:
        reached &= ~_bridged(points, place, sheet, shared.sheets)
    covered = reached.reshape(weight.shape)
    if earlier is not None:
        still = np.isin(earlier.cells, crossed)
        covered[np.searchsorted(crossed, earlier.cells[still])] |= earlier.covered[still]
    cut_fraction = rounded((weight * covered).sum(axis=1) / np.maximum(weight.sum(axis=1), 1e-300))
    kept = np.flatnonzero(cut_fraction > 0.0) if cut.any() else np.zeros(0, dtype=np.int64)
    chosen = crossed[kept]
    found = Crossing(chosen, cut_fraction[kept], fractions_of(at[chosen]), height, float(bare.sum()), advance)
    return found, Samples(_coordinates(rest[cells[chosen]], corners[kept]), weight[kept], covered[kept])


def rounded(cut_fraction: Floats) -> Floats:
    """Return fractions (k,) of sections that are cut, with small ones set to 0 and large ones to 1."""
    found: Floats = np.where(cut_fraction < MIN_CUT, 0.0, np.where(cut_fraction > 1.0 - MIN_CUT, 1.0, cut_fraction))
    return found


def _beyond(points: Floats, place: Place, sheet: Sheet, others: Sequence[Sheet], margin: float) -> Mask:
    """Return which points (k,) on the continuation of a sheet lie beyond another one, seen from its front."""
    beyond = np.zeros(len(points), dtype=bool)
    ask = np.flatnonzero(~sheet.covers(place)) if others else np.zeros(0, dtype=np.int64)
    if not len(ask):
        return beyond
    # From a place slightly before the front, which may lie on the other sheet.
    start = sheet.nearest(Place(*(part[ask] for part in place)), margin)
    for other in others:
        here, there = other.place(points[ask]), other.place(start)
        parted = (here.across < 0.0) != (there.across < 0.0)
        beyond[ask] |= parted & (other.covers(here) | other.covers(there))
    return beyond


def _bridged(points: Floats, place: Place, sheet: Sheet, others: Sequence[Sheet]) -> Mask:
    """Return which points (k,) between a sheet and others in its surface its front is not moved to."""
    bridged = np.zeros(len(points), dtype=bool)
    ask = np.flatnonzero(~sheet.covers(place))
    mine = sheet.nearest(Place(*(part[ask] for part in place)), 0.0) - points[ask]
    for other in others:
        theirs = other.nearest(other.place(points[ask]), 0.0) - points[ask]
        far, farther = np.linalg.norm(mine, axis=1), np.linalg.norm(theirs, axis=1)
        between = np.einsum("kx,kx->k", mine, theirs) < -BETWEEN * far * farther
        bridged[ask] |= between & (far > BRIDGE * farther)
    return bridged


def _coordinates(corner: Floats, points: Floats) -> Floats:
    """Return the barycentric coordinates (k, g, 4) of points (k, g, 3) in cells with corners (k, 4, 3)."""
    inverse = np.linalg.inv((corner[:, 1:] - corner[:, :1]).transpose(0, 2, 1))
    inner = np.einsum("kxy,kgy->kgx", inverse, points - corner[:, :1])
    return np.concatenate([1.0 - inner.sum(axis=2, keepdims=True), inner], axis=2)


def _section_samples(corner: Floats, height: Floats) -> tuple[Floats, Floats]:
    """Return points (k, GRID^2, 3) on cells' sections, and the area (k, GRID^2) m^2 that each represents."""
    pairs = section_of(height > 0.0)
    row = np.arange(len(corner))[:, None]
    first, second = height[row, pairs[:, :, 0]], height[row, pairs[:, :, 1]]
    part = (first / (first - second))[:, :, None]
    a, b, c, d = np.moveaxis(corner[row, pairs[:, :, 0]] * (1.0 - part) + corner[row, pairs[:, :, 1]] * part, 1, 0)
    grid = (np.arange(GRID) + 0.5) / GRID
    u, v = (axis.ravel()[:, None] for axis in np.meshgrid(grid, grid))
    a, b, c, d = (point[:, None] for point in (a, b, c, d))
    points = (1.0 - u) * (1.0 - v) * a + u * (1.0 - v) * b + u * v * c + (1.0 - u) * v * d
    along_u = (1.0 - v) * (b - a) + v * (c - d)
    along_v = (1.0 - u) * (d - a) + u * (c - b)
    return points, np.linalg.norm(np.cross(along_u, along_v), axis=2) / GRID**2
