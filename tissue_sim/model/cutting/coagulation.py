"""Coagulated walls of a hot tool's cut: cells there are stiffer, in proportion to the part that the heat reaches."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tissue_sim.array_types import Floats, Longs
from tissue_sim.model.cutting.crossing import Crossing, fractions_of
from tissue_sim.model.cutting.parts import Parts
from tissue_sim.model.cutting.sheet import Sheet
from tissue_sim.organ.organ import Organ


def stiffening_of(organ: Organ, parts: Parts, sheets: Sequence[Sheet], crossings: Sequence[Crossing]) -> Floats | None:
    """Return the factor on the moduli of every cell of a cut organ, due to the heat of the tools that have cut.

    Tissue within a tool's spread of its cut is stiffer by its factor. A cell has the mean over its volume, which is
    exact where it is stretched along the wall, and an upper bound across it (Voigt 1889). Where the heat of several
    cuts overlaps, the largest factor applies.

    Parameters
    ----------
    organ : Organ
        The organ before its cuts.
    parts : Parts
        The cells after them.
    sheets : Sequence[Sheet]
        The cuts.
    crossings : Sequence[Crossing]
        The cells that each divides.

    Returns
    -------
    Floats | None, shape (m,)
        The factors; None if all cuts are cold.
    """
    factor = np.ones(len(parts.cell_of))
    for number, (sheet, crossing) in enumerate(zip(sheets, crossings, strict=True)):
        stiffening, spread = sheet.coagulation
        if stiffening != 1.0 and spread > 0.0:
            reached = _reached(organ, parts, sheet, crossing, parts.sides[:, number])
            factor = np.maximum(factor, 1.0 + (stiffening - 1.0) * reached)
    return factor if np.any(factor != 1.0) else None


def _reached(organ: Organ, parts: Parts, sheet: Sheet, crossing: Crossing, side: Longs) -> Floats:
    """Return the part (m,) of each cell that the heat of one cut reaches, by the side (m,) of it that the cell is on.

    The part of a cell that is still whole stays cold.
    """
    nodes = organ.cell_nodes[parts.cell_of]
    height, spread = crossing.height[nodes], sheet.coagulation.spread
    above, over, under = (_positive(each) for each in (height, height - spread, height + spread))
    own = np.where(side > 0, above, np.where(side < 0, 1.0 - above, 1.0))
    within = np.where(side > 0, above - over, np.where(side < 0, under - above, under - over))
    beside = np.flatnonzero((side == 0) & (within > 0.0))
    beside = beside[~np.isin(parts.cell_of[beside], crossing.cells)]
    centre = organ.rest_positions[nodes[beside]].mean(axis=1)
    hot = side != 0
    hot[beside] = sheet.covers(sheet.place(centre))
    reached: Floats = np.where(hot, within / np.maximum(own, 1e-300), 0.0).clip(0.0, 1.0)
    return reached


def _positive(height: Floats) -> Floats:
    """Return the fractions (k,) of cells' volumes where heights, given at the corners (k, 4) m, are positive."""
    count = (height > 0.0).sum(axis=1)
    found, crossed = np.where(count == 4, 1.0, 0.0), (count > 0) & (count < 4)
    found[crossed] = fractions_of(height[crossed])
    return found
