"""Cells of an organ in which blades find their places, before and after cuts."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tissue_sim.array_types import Longs
from tissue_sim.model.cutting.cut import CutOrgan
from tissue_sim.model.data.blades import CORNERS, CutCells
from tissue_sim.model.elasticity.cells import shapes_of
from tissue_sim.organ.edges import CELL_FACES
from tissue_sim.organ.organ import Organ


class Sides(NamedTuple):
    """Cells of an uncut organ after its cuts. c cells."""

    below: Longs  # (c, 4) their nodes on the negative side of cuts
    above: Longs  # (c, 4) and on the positive one
    is_cut: Longs  # (c,) 1 for cells whose middle a cut has passed


def sides_of(cut: CutOrgan) -> Sides:
    """Return the cells of an organ on both sides of its cuts.

    Parameters
    ----------
    cut : CutOrgan
        The organ after its cuts.
    """
    cells = cut.uncut.cell_nodes.astype(np.int64)
    below, above = cells.copy(), cells.copy()
    for found, side in ((below, -1), (above, 1)):
        copies = np.flatnonzero(cut.side == side)
        found[cut.cell_of[copies]] = cut.organ.cell_nodes[copies]
    is_cut = np.zeros(len(cells), dtype=np.int64)
    middle = cut.uncut.rest_positions[cells].mean(axis=1)
    for sheet, side in zip(cut.sheets, cut.sides.T, strict=True):
        divided = np.unique(cut.cell_of[side != 0])  # other cells lie beside it, or at the front of another cut
        is_cut[divided] |= sheet.covers(sheet.place(middle[divided]))
    return Sides(below, above, is_cut)


def cut_cells_of(organ: Organ, sides: Sides | None = None) -> CutCells:
    """Return the cells of an organ in which blades find their places.

    Parameters
    ----------
    organ : Organ
        The organ, with its virtual nodes where it is cut.
    sides : Sides | None, optional
        Its cells on both sides of its cuts; None: it has none.
    """
    whole = organ.cell_nodes.astype(np.int64)
    below, above, is_cut = sides or Sides(whole, whole, np.zeros(len(whole), dtype=np.int64))
    source = np.concatenate([np.arange(organ.n_uncut), organ.virtual_of]).astype(np.int64)
    cells = source[below]
    slope = np.ascontiguousarray(shapes_of(organ.rest_positions, cells)[0])
    # The weight of a corner is 1 at its own place.
    base = 1.0 - np.einsum("cax,cax->ca", slope, organ.rest_positions[cells])
    part = np.where(above == below, 0.0, organ.mass[above] / (organ.mass[below] + organ.mass[above]))
    first = np.zeros(organ.n_uncut, dtype=np.int64)
    first[cells.ravel()] = np.repeat(np.arange(len(cells)), CORNERS)
    return CutCells(below.copy(), above.copy(), part, base, slope, is_cut, _neighbours(cells), first)


def _neighbours(cells: Longs) -> Longs:
    """Return the cell (c, 4) behind the face opposite to each corner, -1 where there is none."""
    faces = np.sort(cells[:, CELL_FACES].reshape(-1, 3), axis=1)
    order = np.lexsort(faces.T)
    same = np.flatnonzero((faces[order[1:]] == faces[order[:-1]]).all(axis=1))
    first, second = order[same], order[same + 1]
    found = np.full(len(faces), -1, dtype=np.int64)
    found[first], found[second] = second // CORNERS, first // CORNERS
    return found.reshape(-1, CORNERS)
