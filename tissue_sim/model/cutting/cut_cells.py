"""Cells of an organ as blades find their places in them, before and after cuts."""

from __future__ import annotations

import numpy as np

from tissue_sim.array_types import Longs
from tissue_sim.model.cutting.cut import CutOrgan
from tissue_sim.model.data.blades import CORNERS, CutCells
from tissue_sim.model.elasticity.cells import shapes_of
from tissue_sim.organ.organ import Organ

_FACES = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])  # corners of the face opposite to each


def sides_of(cut: CutOrgan) -> tuple[Longs, Longs]:
    """Return the nodes (c, 4) of every cell of the uncut organ on the negative and on the positive side of its cut.

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
    return below, above


def cut_cells_of(organ: Organ, sides: tuple[Longs, Longs] | None = None) -> CutCells:
    """Return the cells of an organ in which blades find their places.

    Parameters
    ----------
    organ : Organ
        The organ, with its virtual nodes where it is cut.
    sides : tuple[Longs, Longs] | None, shape (c, 4) each, optional
        Nodes on both sides of cuts, see `sides_of`; None: it has none.
    """
    below, above = sides or (organ.cell_nodes.astype(np.int64),) * 2
    source = np.concatenate([np.arange(organ.n_uncut), organ.virtual_of]).astype(np.int64)
    cells = source[below]
    slope = np.ascontiguousarray(shapes_of(organ.rest_positions, cells)[0])
    # The weight of a corner is 1 at its own place.
    base = 1.0 - np.einsum("cax,cax->ca", slope, organ.rest_positions[cells])
    first = np.zeros(organ.n_uncut, dtype=np.int64)
    first[cells.ravel()] = np.repeat(np.arange(len(cells)), CORNERS)
    return CutCells(below.copy(), above.copy(), base, slope, _neighbours(cells), first)


def _neighbours(cells: Longs) -> Longs:
    """Return the cell (c, 4) behind the face opposite to each corner, -1 where there is none."""
    faces = np.sort(cells[:, _FACES].reshape(-1, 3), axis=1)
    order = np.lexsort(faces.T)
    same = np.flatnonzero((faces[order[1:]] == faces[order[:-1]]).all(axis=1))
    first, second = order[same], order[same + 1]
    found = np.full(len(faces), -1, dtype=np.int64)
    found[first], found[second] = second // CORNERS, first // CORNERS
    return found.reshape(-1, CORNERS)
