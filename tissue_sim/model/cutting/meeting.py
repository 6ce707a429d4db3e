"""Cuts that meet: cells that several sheets divide become one copy for each combination of sides that has tissue."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from tissue_sim.array_types import Floats, Ints, Longs, Mask
from tissue_sim.model.cutting.crossing import Crossing, Samples, rounded
from tissue_sim.model.cutting.virtual_nodes import copies_of
from tissue_sim.organ.organ import Organ

MIN_PIECE = 1e-9  # fraction of a cell, below which a piece is rounding
MIN_SECTION = 1e-6  # fraction of a section in a copy, below which the copy has the cut fraction of the whole section
# Tetrahedra that fill the part of one below a plane, by the number of its corners there; each corner is a pair of
# corners of the original tetrahedron: twice the same for a corner itself, otherwise a crossed edge.
_LEFT = {
    1: [[(0, 0), (0, 1), (0, 2), (0, 3)]],
    2: [
        [(0, 0), (0, 2), (0, 3), (1, 1)],
        [(1, 1), (0, 2), (0, 3), (1, 2)],
        [(1, 1), (1, 2), (1, 3), (0, 3)],
    ],
    3: [
        [(0, 0), (1, 1), (2, 2), (0, 3)],
        [(0, 3), (1, 1), (2, 2), (1, 3)],
        [(0, 3), (1, 3), (2, 3), (2, 2)],
    ],
    4: [[(0, 0), (1, 1), (2, 2), (3, 3)]],
}


class Pieces(NamedTuple):
    """Pieces into which cells of an organ are divided. m pieces, s sheets; the first piece of a cell has its index."""

    nodes: Longs  # (m, 4)
    cell: Longs  # (m,) of which it is a part
    sides: Longs  # (m, s) -1 or 1; 0 if a sheet doesn't divide it, and for the part that a front hasn't cut yet
    fraction: Floats  # (m,) of the cell's stiffness
    bears: Mask  # (m,) whether it has a part of the surface: all but the parts that fronts haven't cut yet
    virtual_of: Longs  # (v,) nodes of the organ of which virtual nodes are copies; these follow its own nodes


def groups_of_meeting_cuts(cells: Ints, crossings: Sequence[Crossing]) -> list[list[int]]:
    """Return groups of cuts that meet, each in ascending order: the cells divided by a group's cuts share nodes.

    Parameters
    ----------
    cells : Ints, shape (c, 4)
        Node indices of all cells.
    crossings : Sequence[Crossing]
        The cells that each cut divides.
    """
    nodes = [np.unique(cells[crossing.cells]) for crossing in crossings]
    met = np.array([[len(np.intersect1d(one, other)) > 0 for other in nodes] for one in nodes])
    label = connected_components(coo_array(met), directed=False)[1]
    groups: dict[int, list[int]] = {}
    for number, group in enumerate(label.tolist()):
        groups.setdefault(group, []).append(number)
    return list(groups.values())


def pieces_of(organ: Organ, crossings: Sequence[Crossing], samples: Sequence[Samples], fixed: Ints) -> Pieces:
    """Return the pieces into which the sheets of cuts that meet divide the cells.

    The sheets divide them one after another: each divides the copies that those before it have made, whose virtual
    nodes have the heights of the nodes that they copy. A copy has the volume between all its sheets; one without
    volume is omitted, so that nothing ties the sides of a cut where there is no tissue.

    Parameters
    ----------
    organ : Organ
        The organ before its cuts.
    crossings : Sequence[Crossing]
        The cells that each sheet divides.
    samples : Sequence[Samples]
        Of these cells' sections.
    fixed : Ints, shape (f,)
        Nodes without virtual ones.

    Returns
    -------
    Pieces
        The pieces of all cells.
    """
    count, sheets = len(organ.cell_nodes), len(crossings)
    height = np.stack([crossing.height[organ.cell_nodes] for crossing in crossings], axis=1)  # (c, s, 4)
    found = Pieces(
        nodes=organ.cell_nodes.astype(np.int64),
        cell=np.arange(count),
        sides=np.zeros((count, sheets), dtype=np.int64),
        fraction=np.ones(count),
        bears=np.ones(count, dtype=bool),
        virtual_of=np.zeros(0, dtype=np.int64),
    )
    for number in _order(crossings):
        found = _divided(organ, found, height, number, (crossings[number], samples[number]), fixed)
    return _in_order(organ, found)


def _order(crossings: Sequence[Crossing]) -> list[int]:
    """Return the sheets in the order in which they divide cells, which does not depend on the order of the cuts.

    A sheet that ends at another one comes after it, so that its front doesn't lie in tissue that the other has divided.
    """
    cells, times = np.unique(np.concatenate([crossing.cells for crossing in crossings]), return_counts=True)
    several = cells[times > 1]

    def rank(number: int) -> tuple[float, float]:
        cut = crossings[number].cut_fraction[np.isin(crossings[number].cells, several)]
        return -float(cut.mean()) if len(cut) else 0.0, -crossings[number].area

    return sorted(range(len(crossings)), key=rank)


def _divided(
    organ: Organ, before: Pieces, height: Floats, number: int, cut: tuple[Crossing, Samples], fixed: Ints
) -> Pieces:
    """Return the pieces after one more sheet."""
    crossing, sample = cut
    place = np.full(len(organ.cell_nodes), -1)
    place[crossing.cells] = np.arange(len(crossing.cells))
    chosen = np.flatnonzero(place[before.cell] >= 0)
    cell, sides = before.cell[chosen], before.sides[chosen]
    row = place[cell]
    severed = _cut_fractions(sample, crossing.cut_fraction[row], row, sides, height[cell])
    torn = severed > 0.0
    chosen, cell, sides, severed = chosen[torn], cell[torn], sides[torn], severed[torn]
    above, below = sides.copy(), sides.copy()
    above[:, number], below[:, number] = 1, -1
    up, down = (_volumes(height[cell], one) for one in (above, below))
    whole = np.maximum(up + down, 1e-300)
    # A piece with tissue on one side only isn't cut partly: there is no front in it.
    severed = np.where((up > 0.0) & (down > 0.0), severed, 1.0)
    source = np.concatenate([np.arange(organ.n_nodes), before.virtual_of])
    made = copies_of(
        before.nodes,
        crossing._replace(cells=chosen, cut_fraction=severed, height=crossing.height[source]),
        fixed,
        len(source),
    )
    kept = np.ones(len(before.cell), dtype=bool)
    kept[chosen] = False
    front = severed < 1.0
    parts = [(kept.nonzero()[0], before.nodes[kept], before.sides[kept], np.ones(kept.sum()), before.bears[kept])]
    for own, nodes, size in ((below, made.below, down), (above, made.above, up)):
        real = size > 0.0
        bears = before.bears[chosen][real]
        parts.append((chosen[real], nodes[real], own[real], (severed * size / whole)[real], bears))
    none = np.zeros(np.count_nonzero(front), dtype=bool)
    parts.append((chosen[front], before.nodes[chosen[front]], sides[front], 1.0 - severed[front], none))
    of, nodes, now, fraction, bears = (np.concatenate(column) for column in zip(*parts, strict=True))
    virtual_of = np.concatenate([before.virtual_of, source[made.virtual_of]])
    return Pieces(nodes, before.cell[of], now, before.fraction[of] * fraction, bears, virtual_of)


def _cut_fractions(sample: Samples, severed: Floats, row: Longs, sides: Longs, height: Floats) -> Floats:
    """Return the fractions (k,) of pieces' sections that are cut: of the whole (k,), or within their sides (k, s)."""
    found = severed.copy()
    some = np.flatnonzero(sides.any(axis=1))
    for first in range(0, len(some), 256):
        part = some[first : first + 256]
        at = np.einsum("kgb,ksb->kgs", sample.coordinates[row[part]], height[part])
        within = ((at * sides[part][:, None] > 0.0) | (sides[part] == 0)[:, None]).all(axis=2)
        weight = sample.weight[row[part]]
        size = (weight * within).sum(axis=1)
        cut = (weight * (within & sample.covered[row[part]])).sum(axis=1)
        known = size > MIN_SECTION * weight.sum(axis=1)
        found[part] = np.where(known, cut / np.maximum(size, 1e-300), found[part])
    return rounded(found)


def _volumes(height: Floats, sides: Longs) -> Floats:
    """Return the fractions (k,) of cells where linear functions (k, s, 4) have the signs (k, s); 0 allows either sign.

    Fractions below MIN_PIECE are set to 0.
    """
    corner = np.broadcast_to(np.eye(4), (len(height), 4, 4))
    owner = np.arange(len(height))
    for number in range(sides.shape[1]):
        asked = sides[owner, number] != 0
        at = np.einsum("kab,kb->ka", corner, height[owner, number]) * sides[owner, number][:, None]
        at[~asked] = 1.0
        corner, owner = _clipped(corner, owner, at)
    found = np.bincount(owner, np.abs(np.linalg.det(corner)), len(height))
    real: Floats = np.where(found < MIN_PIECE, 0.0, found)
    return real


def _clipped(corner: Floats, owner: Longs, at: Floats) -> tuple[Floats, Longs]:
    """Return tetrahedra (k, 4, 4) filling the part of others where a function (k, 4) is positive, and their owners."""
    order = np.argsort(at <= 0.0, axis=1, kind="stable")
    row = np.arange(len(at))[:, None]
    corner, at = corner[row, order], at[row, order]
    count = (at > 0.0).sum(axis=1)
    corners, owners = [np.zeros((0, 4, 4))], [np.zeros(0, dtype=np.int64)]
    for number, filling in _LEFT.items():
        chosen = count == number
        own, height = corner[chosen], at[chosen]
        for pairs in filling:
            made = np.empty_like(own)
            for k, (one, other) in enumerate(pairs):
                gap = height[:, one] - height[:, other]
                part = height[:, one] / np.where(gap > 0.0, gap, 1.0) if one != other else np.zeros(len(own))
                made[:, k] = own[:, one] + part[:, None] * (own[:, other] - own[:, one])
            corners.append(made)
            owners.append(owner[chosen])
    return np.concatenate(corners), np.concatenate(owners)


def _in_order(organ: Organ, found: Pieces) -> Pieces:
    """Return the pieces with the first one of each cell at its index, and only virtual nodes that a piece uses."""
    first = np.unique(found.cell, return_index=True)[1]
    rest = np.setdiff1d(np.arange(len(found.cell)), first)
    order = np.concatenate([first, rest])
    own = organ.n_nodes
    used = np.unique(found.nodes)
    used = used[used >= own]
    number = np.arange(own + len(found.virtual_of))
    number[used] = own + np.arange(len(used))
    return Pieces(
        number[found.nodes[order]],
        found.cell[order],
        found.sides[order],
        found.fraction[order],
        found.bears[order],
        found.virtual_of[used - own],
    )
