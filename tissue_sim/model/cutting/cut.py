"""A cut organ: divided cells, virtual nodes with their masses, and a report of each cut."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from tissue_sim.array_types import Floats, Longs
from tissue_sim.errors import UserError
from tissue_sim.model.cutting.crossing import Crossing, crossing_of
from tissue_sim.model.cutting.cut_surface import CutSurface, cut_surface, uncut_surface
from tissue_sim.model.cutting.masses import fastest_mode, shared_masses
from tissue_sim.model.cutting.sheet import Sheet, finer_organ
from tissue_sim.model.cutting.virtual_nodes import Copies, copies_of
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.tool_resolution import CUT_EDGES
from tissue_sim.organ.topology import cell_pieces


class CutReport(NamedTuple):
    """Report of one cut."""

    centre: tuple[float, float, float]  # m, of the divided cells at rest
    area: float  # m^2, of the sheet inside the tissue
    depth: float  # m below the surface, where it is deepest
    resolved: bool  # deep enough for the surface's edges
    resolved_from: float  # m, depth from which it is
    advance: float  # m by which the front was moved, as the cells are too coarse for the stress there
    cells_cut: int  # divided cells
    front_cells: int  # those of them that are torn in part
    new_cells: int
    new_nodes: int
    pieces: int  # that the organ consists of, all cuts together
    free_pieces: int  # those of them that no fixed node holds
    critical_step_before: float = math.nan  # s
    critical_step_after: float = math.nan  # s
    finer: str = ""  # what resolves a cut that is not, and what that costs

    def __str__(self) -> str:
        text = (
            f"{1e6 * self.area:.1f} mm^2 cut, {1e3 * self.depth:.1f} mm deep: {self.cells_cut} cells divided"
            f" ({self.front_cells} in part), {self.new_cells} cells and {self.new_nodes} nodes more, critical step"
            f" {1e6 * self.critical_step_before:.0f} us before and {1e6 * self.critical_step_after:.0f} us after"
        )
        if self.pieces > 1:
            text += f"; {self.pieces} pieces, {self.free_pieces} of them free"
        if not self.resolved:
            text += (
                f"; not resolved: a cut is from {1e3 * self.resolved_from:.1f} mm on, two edges of the surface there"
            )
            text += f"; {self.finer}" if self.finer else ""
        return text


class CutOrgan(NamedTuple):
    """An organ after cuts. n nodes, m cells; those of the uncut organ come first and keep their numbers."""

    organ: Organ  # with virtual nodes
    uncut: Organ
    frequency: float  # rad/s, largest of the uncut organ
    sheets: tuple[Sheet, ...]
    cell_of: Longs  # (m,) the cell of the uncut organ that each stands for
    side: Longs  # (m,) -1 or 1: copies on the two sides of a cut; 0: undivided, and what the front has not torn yet
    fraction: Floats  # (m,) of the cell that each carries
    surface: CutSurface
    reports: tuple[CutReport, ...]  # of each cut, as it was made

    def origin(self, earlier: CutOrgan) -> Longs:
        """Return the node (n,) of the same organ after fewer cuts whose place each node takes over.

        Parameters
        ----------
        earlier : CutOrgan
            The organ before the last cut.
        """
        found = np.arange(self.organ.n_nodes)
        virtual = self.uncut.n_nodes
        # Of the earlier organ, the copy on each side; where it wasn't divided yet, the cell itself.
        before = np.stack([np.arange(len(self.uncut.cell_nodes))] * 3, axis=1)
        copies = np.flatnonzero(earlier.side)
        before[earlier.cell_of[copies], earlier.side[copies] + 1] = copies
        cells = np.flatnonzero(self.side)
        nodes = self.organ.cell_nodes[cells]
        source = earlier.organ.cell_nodes[before[self.cell_of[cells], self.side[cells] + 1]]
        new = nodes >= virtual
        found[nodes[new]] = source[new]
        return found


class _Parts(NamedTuple):
    """Cells of a cut organ, the cells for which they stand, and virtual nodes."""

    nodes: Longs  # (m, 4)
    cell_of: Longs
    side: Longs
    fraction: Floats
    virtual_of: Longs
    apart: Longs  # (m, 4) as nodes, with numbers of their own for the virtual nodes of fixed ones


def not_cut(organ: Organ) -> CutOrgan:
    """Return an organ before its first cut.

    Parameters
    ----------
    organ : Organ
        The organ.

    Raises
    ------
    UserError
        When it has no cells, or was cut before by others.
    """
    if organ.n_virtual:
        raise UserError(f"organ '{organ.name}' was cut before and saved; load the uncut organ, and cut it again")
    if not len(organ.cell_nodes):
        raise UserError(f"organ '{organ.name}' has no cells, and springs can't be cut; calibrate it first")
    whole = np.arange(len(organ.cell_nodes))
    side, fraction = np.zeros(len(whole), dtype=np.int64), np.ones(len(whole))
    return CutOrgan(organ, organ, fastest_mode(organ), (), whole, side, fraction, uncut_surface(organ), ())


def cut_again(before: CutOrgan, sheet: Sheet) -> CutOrgan:
    """Return an organ after one more cut.

    The cut is made in the uncut organ together with the earlier ones, so that the order of cuts doesn't matter. One
    that continues the last ones to a greater depth takes their place.

    Parameters
    ----------
    before : CutOrgan
        The organ before.
    sheet : Sheet
        The cut.

    Returns
    -------
    CutOrgan
        The organ after.

    Raises
    ------
    UserError
        When the cut divides no cell, or comes within a cell of an earlier one.
    """
    organ = before.uncut
    kept = tuple(one for one in before.sheets if not sheet.deepens(one))
    sheets = (*kept, sheet)
    rest = organ.rest_positions
    crossings = [crossing_of(rest, organ.cell_nodes, one) for one in sheets]
    if not len(crossings[-1].cells):
        raise UserError(f"the cut divides no cell of organ '{organ.name}'; cut deeper, or elsewhere")
    _check_far(organ, crossings)
    made, first = [], organ.n_nodes
    for crossing in crossings:
        made.append(copies_of(organ.cell_nodes, crossing, organ.fixed, first))
        first += len(made[-1].virtual_of)
    parts = _put_together(organ, crossings, made)
    after = _organ_of(organ, parts, before.frequency)
    pieces, free = _pieces(organ, parts)
    resolved_from = CUT_EDGES * sheet.edge_at(organ)
    crossing, front = crossings[-1], int(np.count_nonzero(crossings[-1].share < 1.0))
    x, y, z = rest[organ.cell_nodes[crossing.cells]].mean(axis=(0, 1)).tolist()
    report = CutReport(
        centre=(x, y, z),
        area=crossing.area,
        depth=sheet.reached,
        resolved=sheet.reached >= resolved_from,
        resolved_from=resolved_from,
        advance=crossing.advance,
        cells_cut=len(crossing.cells),
        front_cells=front,
        new_cells=len(crossing.cells) + front,
        new_nodes=len(made[-1].virtual_of),
        pieces=pieces,
        free_pieces=free,
        finer="" if sheet.reached >= resolved_from else finer_organ(organ, sheet),
    )
    earlier = [report for report, one in zip(before.reports, before.sheets, strict=True) if not sheet.deepens(one)]
    surface = cut_surface(organ, list(zip(crossings, made, strict=True)))
    made_of = parts.cell_of, parts.side, parts.fraction
    return CutOrgan(after, organ, before.frequency, sheets, *made_of, surface, (*earlier, report))


def _check_far(organ: Organ, crossings: Sequence[Crossing]) -> None:
    """Refuse a cut whose cells have a node in common with an earlier one's."""
    *earlier, last = (np.unique(organ.cell_nodes[crossing.cells]) for crossing in crossings)
    for number, nodes in enumerate(earlier):
        if np.isin(last, nodes).any():
            raise UserError(
                f"the cut comes within a cell of cut {number + 1}: cuts must not meet; continue that one by the same"
                " polyline and direction with a greater depth, or cut the uncut organ along one polyline"
            )


def _put_together(organ: Organ, crossings: Sequence[Crossing], made: Sequence[Copies]) -> _Parts:
    """Return all cells: those of the organ, of which divided ones become the negative copy, and those that are added.

    These are the positive copies and, of cells at the front, one whole cell for what is not torn yet.
    """
    nodes = organ.cell_nodes.astype(np.int64)
    count, apart = len(nodes), nodes.copy()
    side, fraction = np.zeros(count, dtype=np.int64), np.ones(count)
    more, more_apart, more_of, more_side, more_fraction, loose = [], [], [], [], [], 0
    for crossing, copies in zip(crossings, made, strict=True):
        cells, share, part = crossing.cells, crossing.share, crossing.fraction
        front = share < 1.0
        whole = nodes[cells[front]]
        below, above = (np.where(found < 0, found - loose, found) for found in (copies.below_apart, copies.above_apart))
        loose -= min(0, int(copies.below_apart.min()), int(copies.above_apart.min()))
        more += [copies.above, whole]
        more_apart += [above, whole]
        more_of += [cells, cells[front]]
        more_side += [np.ones(len(cells), dtype=np.int64), np.zeros(len(whole), dtype=np.int64)]
        more_fraction += [share * part, 1.0 - share[front]]
        nodes[cells], apart[cells], side[cells], fraction[cells] = copies.below, below, -1, share * (1.0 - part)
    return _Parts(
        nodes=np.concatenate([nodes, *more]),
        cell_of=np.concatenate([np.arange(count), *more_of]),
        side=np.concatenate([side, *more_side]),
        fraction=np.concatenate([fraction, *more_fraction]),
        virtual_of=np.concatenate([copies.virtual_of for copies in made]),
        apart=np.concatenate([apart, *more_apart]),
    )


def _organ_of(organ: Organ, parts: _Parts, frequency: float) -> Organ:
    """Return the organ of cells that carry fractions of the fitted moduli, with virtual nodes."""
    source = np.concatenate([np.arange(organ.n_nodes), parts.virtual_of])
    made = replace(
        organ,
        cell_nodes=parts.nodes.astype(np.int32),
        cell_mu=organ.cell_mu[parts.cell_of] * parts.fraction,
        cell_lambda=organ.cell_lambda[parts.cell_of] * parts.fraction,
        virtual_of=parts.virtual_of.astype(np.int32),
        mass=organ.mass[source],
        damping=organ.damping[source],
        return_stiffness=organ.return_stiffness[source],
    )
    mass = shared_masses(organ, made, frequency)
    share = mass / organ.mass[source]
    return replace(
        made, mass=mass, damping=organ.damping[source] * share, return_stiffness=organ.return_stiffness[source] * share
    )


def _pieces(organ: Organ, parts: _Parts) -> tuple[int, int]:
    """Return how many pieces the cells make, and how many of them no fixed node holds; 0 where none is fixed."""
    nodes = np.where(parts.apart < 0, organ.n_nodes + len(parts.virtual_of) - 1 - parts.apart, parts.apart)
    size = int(nodes.max()) + 1
    label = cell_pieces(nodes, size)
    used = np.unique(label[nodes[:, 0]])
    held = np.zeros(size, dtype=bool)
    held[organ.fixed] = True
    held[organ.n_nodes + len(parts.virtual_of) :] = True  # virtual nodes of fixed ones
    return len(used), len(np.setdiff1d(used, label[held]))
