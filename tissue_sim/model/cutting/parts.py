"""Cells of an organ after all of its cuts: of single cuts, and of cuts that meet."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tissue_sim.array_types import Floats, Ints, Longs
from tissue_sim.model.cutting.crossing import Crossing, Samples
from tissue_sim.model.cutting.joining import JoinedCuts
from tissue_sim.model.cutting.meeting import Pieces, groups_of_meeting_cuts, pieces_of
from tissue_sim.model.cutting.virtual_nodes import Copies, copies_of
from tissue_sim.organ.organ import Organ


class CutCells(NamedTuple):
    """Cells that a cut, or a group of meeting cuts, divides."""

    numbers: tuple[int, ...]  # of the cuts, ascending
    crossings: tuple[Crossing, ...]  # of each of them
    pieces: Pieces  # of all cells of the organ, with their sides of these cuts
    copies: Copies | None  # of a cut that meets no other one


class Parts(NamedTuple):
    """Cells of a cut organ, the cells of which they are parts, and virtual nodes. m cells, s cuts."""

    nodes: Longs  # (m, 4)
    cell_of: Longs  # (m,)
    sides: Longs  # (m, s)
    side: Longs  # (m,) of the last cut that divides it
    fraction: Floats  # (m,)
    virtual_of: Longs  # (v,)


def divided_by_cuts(organ: Organ, found: Sequence[tuple[Crossing, Samples]], fixed: Ints) -> list[CutCells]:
    """Return the cells that cuts divide, for each single cut or group of meeting cuts.

    Parameters
    ----------
    organ : Organ
        The organ before its cuts.
    found : Sequence[tuple[Crossing, Samples]]
        The cells that each sheet divides.
    fixed : Ints, shape (f,)
        Nodes that have no virtual ones.

    Returns
    -------
    list[CutCells]
        In the order of the first cut of each; virtual nodes are numbered consecutively.
    """
    first, made = organ.n_nodes, []
    for group in groups_of_meeting_cuts(organ.cell_nodes, [crossing for crossing, _ in found]):
        crossings = tuple(found[number][0] for number in group)
        copies = None
        if len(group) == 1:
            copies = copies_of(organ.cell_nodes, crossings[0], fixed, first)
            pieces = _of_one(organ, crossings[0], copies)
        else:
            pieces = pieces_of(organ, crossings, [found[number][1] for number in group], fixed)
            virtual = pieces.nodes >= organ.n_nodes
            pieces = pieces._replace(nodes=pieces.nodes + np.where(virtual, first - organ.n_nodes, 0))
        made.append(CutCells(tuple(group), crossings, pieces, copies))
        first += len(pieces.virtual_of)
    return made


def _of_one(organ: Organ, crossing: Crossing, copies: Copies) -> Pieces:
    """Return the pieces of all cells after one cut: a divided one becomes its negative copy, and others are added.

    These are the positive copies and, for cells at the front, one whole cell for the part that is not cut yet.
    """
    cells, cut, part = crossing.cells, crossing.cut_fraction, crossing.fraction
    nodes = organ.cell_nodes.astype(np.int64)
    count, front = len(nodes), cut < 1.0
    whole = nodes[cells[front]]
    side, fraction = np.zeros(count, dtype=np.int64), np.ones(count)
    nodes[cells], side[cells], fraction[cells] = copies.below, -1, cut * (1.0 - part)
    more = [np.ones(len(cells), dtype=np.int64), np.zeros(len(whole), dtype=np.int64)]
    bears = np.ones(count + len(cells) + len(whole), dtype=bool)
    bears[count + len(cells) :] = False
    return Pieces(
        nodes=np.concatenate([nodes, copies.above, whole]),
        cell=np.concatenate([np.arange(count), cells, cells[front]]),
        sides=np.concatenate([side, *more])[:, None],
        fraction=np.concatenate([fraction, cut * part, 1.0 - cut[front]]),
        bears=bears,
        virtual_of=copies.virtual_of,
    )


def merged_parts(organ: Organ, count: int, cuts: Sequence[CutCells]) -> Parts:
    """Return all cells: those of the organ, with divided ones replaced by their first piece, and the added ones.

    Parameters
    ----------
    organ : Organ
        The organ before its cuts.
    count : int
        Number of cuts.
    cuts : Sequence[CutCells]
        Cells that they divide; no two have a node in common.
    """
    own = len(organ.cell_nodes)
    nodes: list[Longs] = [organ.cell_nodes.astype(np.int64)]
    sides: list[Longs] = [np.zeros((own, count), dtype=np.int64)]
    fraction: list[Floats] = [np.ones(own)]
    cell_of: list[Longs] = [np.arange(own)]
    for cut in cuts:
        pieces = cut.pieces
        signs = np.zeros((len(pieces.cell), count), dtype=np.int64)
        signs[:, list(cut.numbers)] = pieces.sides
        touched = np.unique(np.concatenate([crossing.cells for crossing in cut.crossings]))
        nodes[0][touched], sides[0][touched] = pieces.nodes[touched], signs[touched]
        fraction[0][touched] = pieces.fraction[touched]
        nodes.append(pieces.nodes[own:])
        sides.append(signs[own:])
        fraction.append(pieces.fraction[own:])
        cell_of.append(pieces.cell[own:])
    signs = np.concatenate(sides)
    return Parts(
        nodes=np.concatenate(nodes),
        cell_of=np.concatenate(cell_of),
        sides=signs,
        side=_last_side(signs),
        fraction=np.concatenate(fraction),
        virtual_of=np.concatenate([cut.pieces.virtual_of for cut in cuts]),
    )


def with_sides_of_each(parts: Parts, groups: Sequence[JoinedCuts]) -> Parts:
    """Return cells with their sides of every cut, in place of those of groups of cuts that lie in one surface.

    Parameters
    ----------
    parts : Parts
        The cells.
    groups : Sequence[JoinedCuts]
        The groups.
    """
    sides = np.zeros((len(parts.cell_of), sum(len(group.numbers) for group in groups)), dtype=np.int64)
    for column, group in zip(parts.sides.T, groups, strict=True):
        for number, way, (crossing, _) in zip(group.numbers, group.ways, group.parts, strict=True):
            sides[:, number] = np.where(np.isin(parts.cell_of, crossing.cells), way * column, 0)
    return parts._replace(sides=sides, side=_last_side(sides))


def _last_side(sides: Longs) -> Longs:
    """Return the sides (m,) of the last cuts that divide cells, by those of all cuts (m, s)."""
    side = np.zeros(len(sides), dtype=np.int64)
    for column in sides.T:
        side = np.where(column != 0, column, side)
    return side
