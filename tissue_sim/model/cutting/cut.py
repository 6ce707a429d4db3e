"""A cut organ: divided cells, virtual nodes with their masses, and a report of each cut."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from tissue_sim.array_types import Floats, Longs
from tissue_sim.errors import UserError
from tissue_sim.model.cutting.coagulation import stiffening_of
from tissue_sim.model.cutting.crossing import Crossing, Earlier, crossing_among
from tissue_sim.model.cutting.cut_surface import CutSurface, cut_surface, uncut_surface
from tissue_sim.model.cutting.joining import Divided, JoinedCuts, includes, joined_cuts, surfaces_of, way_of
from tissue_sim.model.cutting.masses import damping_of_copies, distributed_masses, fastest_mode
from tissue_sim.model.cutting.parts import Parts, divided_by_cuts, merged_parts, with_sides_of_each
from tissue_sim.model.cutting.sheet import Sheet, finer_organ
from tissue_sim.model.cutting.thickness import lip_thickness, with_ligament
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.tool_resolution import CUT_EDGES
from tissue_sim.organ.topology import cell_pieces


class CutReport(NamedTuple):
    """Report of one cut."""

    centre: tuple[float, float, float]  # m, of the divided cells at rest
    area: float  # m^2, of the sheet inside the tissue
    depth: float  # m below the surface, where it is deepest
    resolved: bool  # it is deep enough for the surface's edges, and its lips are thick enough
    resolved_from: float  # m, least depth, and least thickness of its lips, at which it is resolved
    lip: float  # m, thickness of the thinner lip: from the sheet to the surface
    advance: float  # m by which the front was moved, as the cells are too coarse for the stress there
    cells_cut: int  # divided cells
    front_cells: int  # those of them that are cut partly
    new_cells: int
    new_nodes: int
    pieces: int  # that the organ consists of, all cuts together
    free_pieces: int  # those of them that no fixed node holds
    critical_step_before: float = math.nan  # s
    critical_step_after: float = math.nan  # s
    finer: str = ""  # command that makes an organ which resolves the cut, and its cost
    stiffer_cells: int = 0  # at walls that a hot tool has coagulated, of all cuts together
    includes_another: bool = False  # it was there already when a path within it was to be cut, which changed nothing

    def __str__(self) -> str:
        text = (
            f"{1e6 * self.area:.1f} mm^2 cut, {1e3 * self.depth:.1f} mm deep: {self.cells_cut} cells divided"
            f" ({self.front_cells} in part), {self.new_cells} cells and {self.new_nodes} nodes more, critical step"
            f" {1e6 * self.critical_step_before:.0f} us before and {1e6 * self.critical_step_after:.0f} us after"
        )
        if self.includes_another:
            text += "; it was there already, and the path lies within it: nothing has changed"
        if self.stiffer_cells:
            text += f"; {self.stiffer_cells} cells at coagulated walls are stiffer"
        if self.pieces > 1:
            text += f"; {self.pieces} pieces, {self.free_pieces} of them free"
        if not self.resolved:
            deep, lip = f"it is {1e3 * self.depth:.1f} mm deep", f"its thinner lip is {1e3 * self.lip:.1f} mm thick"
            lack = deep if self.depth < self.resolved_from else lip
            needed = f"{1e3 * self.resolved_from:.1f} mm, two edges of the surface there"
            text += f"; not resolved: {lack}, and needs {needed}"
            text += f"; {self.finer}" if self.finer else ""
        return text


class CutOrgan(NamedTuple):
    """An organ after cuts. n nodes, m cells; those of the uncut organ come first and keep their indices."""

    organ: Organ  # with virtual nodes
    uncut: Organ
    frequency: float  # rad/s, largest of the uncut organ
    sheets: tuple[Sheet, ...]
    cell_of: Longs  # (m,) the cell of the uncut organ of which each is a part
    side: Longs  # (m,) -1 or 1: copies on the two sides of the last cut through the cell; 0: undivided cells
    fraction: Floats  # (m,) of the cell that each represents
    surface: CutSurface
    reports: tuple[CutReport, ...]  # of each cut, as it was made
    sides: Longs  # (m, s) the same for each of the cuts
    divided: tuple[Earlier, ...]  # cells that each of the cuts has divided
    continued: Longs  # (e, 2) for each cut before the last one, the cut here of which it is part, and 1 or -1: its way

    def origin(self, earlier: CutOrgan) -> Longs:
        """Return the node (n,) of the same organ before the last cut which each node replaces.

        Parameters
        ----------
        earlier : CutOrgan
            The organ before the last cut.
        """
        found = np.arange(self.organ.n_nodes)
        virtual = self.uncut.n_nodes
        nodes = self.organ.cell_nodes
        cells = np.flatnonzero((nodes >= virtual).any(axis=1))
        # The copy of the earlier organ on the same sides; the cell itself if it wasn't divided yet.
        place, way = self.continued.T
        mine = self.sides[cells][:, place] * way
        copies = np.flatnonzero(np.isin(earlier.cell_of, self.cell_of[cells]))
        order = copies[np.argsort(earlier.cell_of[copies], kind="stable")]
        cell = earlier.cell_of[order]
        first, last = (np.searchsorted(cell, self.cell_of[cells], side) for side in ("left", "right"))
        before = np.empty(len(cells), dtype=np.int64)
        for number, (start, end) in enumerate(zip(first.tolist(), last.tolist(), strict=True)):
            theirs = earlier.sides[order[start:end]]
            fit = (theirs == mine[number]).sum(axis=1) - len(place) * (theirs * mine[number] < 0).sum(axis=1)
            before[number] = order[start + int(np.argmax(fit))]
        new = nodes[cells] >= virtual
        found[nodes[cells][new]] = earlier.organ.cell_nodes[before][new]
        return found


def without_cuts(organ: Organ) -> CutOrgan:
    """Return an organ before its first cut.

    Parameters
    ----------
    organ : Organ
        The organ.

    Raises
    ------
    UserError
        If it has no cells, or was loaded with cuts.
    """
    if organ.n_virtual:
        raise UserError(f"organ '{organ.name}' was cut before and saved; load the uncut organ, and cut it again")
    if not len(organ.cell_nodes):
        raise UserError(f"organ '{organ.name}' has no cells, and springs can't be cut; calibrate it first")
    whole = np.arange(len(organ.cell_nodes))
    side, fraction = np.zeros(len(whole), dtype=np.int64), np.ones(len(whole))
    sides = np.zeros((len(whole), 0), dtype=np.int64)
    none = np.zeros((0, 2), dtype=np.int64)
    frequency, surface = fastest_mode(organ), uncut_surface(organ)
    return CutOrgan(organ, organ, frequency, (), whole, side, fraction, surface, (), sides, (), none)


def cut_again(before: CutOrgan, sheet: Sheet) -> CutOrgan:
    """Return an organ after one more cut.

    The cut is made in the uncut organ together with the earlier ones, so that the order of cuts doesn't matter. A cut
    that includes earlier ones replaces them, and one that an earlier one includes changes nothing. Cells that a blade
    has divided stay divided in the later stages of its cut.

    Parameters
    ----------
    before : CutOrgan
        The organ before.
    sheet : Sheet
        The cut.

    Raises
    ------
    UserError
        If the cut divides no cell, or meets an earlier one where the surface can't be split.
    """
    organ = before.uncut
    sheet = with_ligament(organ, sheet)
    here = _beside_others(before, sheet)
    if here.over is not None:
        made = cut_again(before, here.over)
        return made._replace(reports=(*made.reports[:-1], made.reports[-1]._replace(includes_another=True)))
    kept, sheets = here.kept, here.sheets
    held = [[before.divided[number]] for number in kept]
    held.append([one for number, one in enumerate(before.divided) if number not in kept])
    groups = joined_cuts(organ, sheets, here.found, held)
    whole = [group.whole for group in groups]
    cuts = divided_by_cuts(organ, whole, organ.fixed)
    parts = with_sides_of_each(merged_parts(organ, len(groups), cuts), groups)
    found = [group.parts[group.numbers.index(k)] for k in range(len(sheets)) for group in groups if k in group.numbers]
    stiffening = stiffening_of(organ, parts, sheets, [one for one, _ in found])
    after = _organ_of(organ, parts, before.frequency, stiffening)
    surface = _with_walls_of_each(cut_surface(organ, cuts), after.rest_positions, sheets, groups)
    # Pieces are counted as if fixed nodes had virtual nodes, too.
    free_parts = merged_parts(organ, len(groups), divided_by_cuts(organ, whole, organ.fixed[:0]))
    pieces, free = _count(organ, free_parts)
    stiffer = 0 if stiffening is None else int(np.count_nonzero(stiffening != 1.0))
    report = _report(organ, sheet, found[-1][0])._replace(pieces=pieces, free_pieces=free, stiffer_cells=stiffer)
    last = next(index for index, group in enumerate(groups) if len(sheets) - 1 in group.numbers)
    if len(groups[last].numbers) > 1 or any(last in cut.numbers and len(cut.numbers) > 1 for cut in cuts):
        report = report._replace(
            new_cells=len(parts.nodes) - len(before.organ.cell_nodes),
            new_nodes=len(parts.virtual_of) - before.organ.n_virtual,
        )
    else:
        report = report._replace(new_nodes=len(cuts[-1].pieces.virtual_of))
    divided = tuple(Earlier(one.cells, one.height, samples.covered) for one, samples in found)
    return CutOrgan(
        organ=after,
        uncut=organ,
        frequency=before.frequency,
        sheets=sheets,
        cell_of=parts.cell_of,
        side=parts.side,
        fraction=parts.fraction,
        surface=surface,
        reports=(*(before.reports[number] for number in kept), report),
        sides=parts.sides,
        divided=divided,
        continued=_continued(organ, before, kept, divided),
    )


class _Beside(NamedTuple):
    """A new cut, and those that remain beside it."""

    kept: list[int]  # numbers of the earlier ones that the new one doesn't include
    sheets: tuple[Sheet, ...]  # these, and the new one
    found: list[Divided]  # cells that each of them divides by itself
    over: Sheet | None  # earlier one that includes the new one


def _beside_others(before: CutOrgan, sheet: Sheet) -> _Beside:
    """Return a new cut, and the earlier ones that it doesn't include."""
    organ = before.uncut
    kept = [number for number, one in enumerate(before.sheets) if not sheet.deepens(one)]
    # A blade's cut may still grow, and one that is made again has been compared with the others before.
    alone = sheet.mark > 0 or any(one is sheet for one in before.sheets)
    while True:
        sheets = (*(before.sheets[number] for number in kept), sheet)
        found = [
            crossing_among(
                organ.rest_positions,
                organ.cell_nodes,
                one,
                [other for other in sheets if other is not one],
                _earlier(before, one),
            )
            for one in sheets
        ]
        if not len(found[-1][0].cells):
            raise UserError(f"the cut divides no cell of organ '{organ.name}'; cut deeper, or elsewhere")
        groups = surfaces_of(organ, sheets, [one for one, _ in found])
        group = next(group for group in groups if len(kept) in group)
        beside = [number for number in sorted(group) if number < len(kept) and not (alone or sheets[number].mark)]
        over = [sheets[number] for number in beside if includes(sheets[number], sheet, organ, found[-1])]
        within = [kept[number] for number in beside if includes(sheet, sheets[number], organ, found[number])]
        if over or not within:
            return _Beside(kept, sheets, found, over[0] if over else None)
        kept = [number for number in kept if number not in within]


def _continued(organ: Organ, before: CutOrgan, kept: list[int], divided: Sequence[Earlier]) -> Longs:
    """Return for each cut before the last one the cut of which it is part now, and its way there (e, 2)."""
    found = np.empty((len(before.sheets), 2), dtype=np.int64)
    for number, one in enumerate(before.divided):
        place = kept.index(number) if number in kept else len(kept)
        found[number] = place, way_of(one.height, divided[place].height, np.unique(organ.cell_nodes[one.cells]))
    return found


def _with_walls_of_each(
    surface: CutSurface, rest: Floats, sheets: Sequence[Sheet], groups: Sequence[JoinedCuts]
) -> CutSurface:
    """Return the surface with the number of the nearest cut at each wall, in place of that of its group of cuts."""
    wall = surface.wall.copy()
    for index, group in enumerate(groups):
        mine = np.flatnonzero(surface.wall == index + 1)
        middle = surface.at(rest)[surface.triangles[mine]].mean(axis=1)
        numbers = np.array(group.numbers)
        away = [np.linalg.norm(sheets[k].nearest(sheets[k].place(middle), 0.0) - middle, axis=1) for k in numbers]
        wall[mine] = numbers[np.argmin(away, axis=0)] + 1
    return surface._replace(wall=wall)


def _earlier(before: CutOrgan, sheet: Sheet) -> Earlier | None:
    """Return the cells that earlier stages of a blade's cut, whose sheet is given, have divided."""
    stages = [number for number, one in enumerate(before.sheets) if sheet.mark and sheet.deepens(one)]
    return before.divided[stages[0]] if stages else None


def _report(organ: Organ, sheet: Sheet, crossing: Crossing) -> CutReport:
    """Return the report of a cut from its sheet and the cells that it crosses."""
    resolved_from = CUT_EDGES * sheet.edge_at(organ)
    lip = lip_thickness(organ, sheet)
    resolved = min(sheet.reached, lip) >= resolved_from
    front = int(np.count_nonzero(crossing.cut_fraction < 1.0))
    x, y, z = organ.rest_positions[organ.cell_nodes[crossing.cells]].mean(axis=(0, 1)).tolist()
    return CutReport(
        centre=(x, y, z),
        area=crossing.area,
        depth=sheet.reached,
        resolved=resolved,
        resolved_from=resolved_from,
        lip=lip,
        advance=crossing.advance,
        cells_cut=len(crossing.cells),
        front_cells=front,
        new_cells=len(crossing.cells) + front,
        new_nodes=0,
        pieces=1,
        free_pieces=0,
        finer="" if resolved else finer_organ(organ, sheet, lip),
    )


def _organ_of(organ: Organ, parts: Parts, frequency: float, stiffening: Floats | None) -> Organ:
    """Return the organ of cells that carry fractions of the fitted moduli, with virtual nodes.

    Heat changes moduli, by the factors (m,), but no masses: the critical step is shorter by at most the factor's root.
    """
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
    mass = distributed_masses(organ, made, frequency)
    part = mass / organ.mass[source]
    made = replace(made, mass=mass, return_stiffness=organ.return_stiffness[source] * part)
    made = replace(made, damping=damping_of_copies(organ, made))
    if stiffening is None:
        return made
    return replace(made, cell_mu=made.cell_mu * stiffening, cell_lambda=made.cell_lambda * stiffening)


def _count(organ: Organ, parts: Parts) -> tuple[int, int]:
    """Return the number of pieces, and of those that no fixed node holds; the latter is 0 if no node is fixed."""
    source = np.concatenate([np.arange(organ.n_nodes), parts.virtual_of])
    label = cell_pieces(parts.nodes, len(source))
    used = np.unique(label[parts.nodes[:, 0]])
    held = np.isin(source, organ.fixed)
    return len(used), len(np.setdiff1d(used, label[held]))
