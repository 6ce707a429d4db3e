"""Cuts whose sheets lie in one surface: they have the same heights there, and divide cells as one cut."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tissue_sim.array_types import Floats, Ints, Longs
from tissue_sim.errors import UserError
from tissue_sim.model.cutting.crossing import (
    ADVANCE,
    MIN_HEIGHT,
    Crossing,
    Earlier,
    Samples,
    Shared,
    crossing_among,
    rounded,
)
from tissue_sim.model.cutting.point_names import PARTLY_SHARED
from tissue_sim.model.cutting.sheet import Sheet
from tissue_sim.organ.organ import Organ

# Largest distance between two sheets in one surface, in mean edges of the crossed cells: half of it moves nodes anyway.
SAME = 2.0 * MIN_HEIGHT
# Mean edges of the crossed cells by which two sheets differ at least in each cell that they divide in different ways.
APART = 1e-6

Divided = tuple[Crossing, Samples]


class JoinedCuts(NamedTuple):
    """Cuts in one surface."""

    numbers: tuple[int, ...]  # of the cuts
    ways: tuple[int, ...]  # 1 or -1, whether the positive side of each is that of all
    whole: Divided  # cells that they divide together
    parts: tuple[Divided, ...]  # cells that each of them divides


def joined_cuts(
    organ: Organ, sheets: Sequence[Sheet], found: Sequence[Divided], before: Sequence[Sequence[Earlier]]
) -> list[JoinedCuts]:
    """Return the cuts of an organ, of which those that lie in one surface and meet are joined.

    The tissue between two of them stays whole: their fronts are not moved through it.

    Parameters
    ----------
    organ : Organ
        The organ before its cuts.
    sheets : Sequence[Sheet]
        The cuts.
    found : Sequence[Divided]
        The cells that each divides by itself.
    before : Sequence[Sequence[Earlier]]
        Cells that each, and those that it includes, had already divided: their nodes stay on their sides.

    Raises
    ------
    UserError
        If a cut lies in the surface of another one in some cells, and leaves it in others.
    """
    groups = surfaces_of(organ, sheets, [crossing for crossing, _ in found])
    made = []
    for group in groups:
        first = group[0]
        is_new = not before[first] or sheets[first].mark  # the stages of a blade's cut have been considered already
        if len(group) == 1 and is_new:
            made.append(JoinedCuts((first,), (1,), found[first], (found[first],)))
        else:
            made.append(_joined(organ, sheets, group, found, before))
    for index, one in enumerate(made):
        for other in made[:index]:
            _check_apart(organ, one.whole[0], other.whole[0])
    return made


def surfaces_of(organ: Organ, sheets: Sequence[Sheet], crossings: Sequence[Crossing]) -> list[list[int]]:
    """Return groups of cuts that meet and lie in one surface, that of the first of each group.

    Parameters
    ----------
    organ : Organ
        The organ before its cuts.
    sheets : Sequence[Sheet]
        The cuts.
    crossings : Sequence[Crossing]
        The cells that each divides.
    """
    across = [sheet.place(organ.rest_positions).across for sheet in sheets]
    nodes = [np.unique(organ.cell_nodes[crossing.cells]) for crossing in crossings]

    def meet(some: list[int], others: list[int]) -> bool:
        return any(len(np.intersect1d(nodes[one], nodes[other])) > 0 for one in some for other in others)

    def lies_in(one: int, lead: int) -> bool:
        """Return whether a cut lies in the surface of another one, continued, at the nodes of its cells."""
        there = nodes[one]
        apart = across[one][there] - way_of(across[one], across[lead], there) * across[lead][there]
        return bool(np.abs(apart).max(initial=0.0) <= SAME * crossings[one].advance / ADVANCE)

    def led(group: list[int]) -> list[int]:
        """Return the group beginning with the cut whose surface all others lie in; empty if there is none."""
        for lead in group:
            if all(lies_in(one, lead) for one in group if one != lead):
                return [lead, *(one for one in group if one != lead)]
        return []

    groups: list[list[int]] = []
    for number in range(len(crossings)):
        mine, rest = [number], []
        for group in groups:
            # Cuts that already meet in another way stay apart.
            joins = meet(group, [number]) and not meet(group, [one for one in mine if one != number])
            together = led(sorted([*group, *mine])) if joins else []
            if together:
                mine = together
            else:
                rest.append(group)
        groups = [*rest, mine]
    return sorted(groups, key=min)


def includes(one: Sheet, other: Sheet, organ: Organ, divided: Divided) -> bool:
    """Return whether a sheet covers all of another one in its surface.

    Parameters
    ----------
    one : Sheet
        The sheet.
    other : Sheet
        The other one.
    organ : Organ
        The organ before its cuts.
    divided : Divided
        The cells that the other one divides.
    """
    crossing, samples = divided
    corner = organ.rest_positions[organ.cell_nodes[crossing.cells]]
    points = np.einsum("kgb,kbx->kgx", samples.coordinates, corner).reshape(-1, 3)
    points = points[other.covers(other.place(points))]
    return bool(one.covers(one.place(points), MIN_HEIGHT * crossing.advance / ADVANCE).all())


def way_of(one: Floats, other: Floats, nodes: Ints | Longs) -> int:
    """Return whether two sheets, given by their heights (n,), have the same positive side at nodes: 1, or else -1."""
    return 1 if float(one[nodes] @ other[nodes]) >= 0.0 else -1


def _check_apart(organ: Organ, one: Crossing, other: Crossing) -> None:
    """Refuse sheets that are the same in some cells only."""
    nodes = organ.cell_nodes[np.intersect1d(one.cells, other.cells)]
    apart = np.minimum(*(np.abs(one.height[nodes] - way * other.height[nodes]).max(axis=1) for way in (1, -1)))
    if np.any(apart < APART * one.advance / ADVANCE):
        raise UserError(PARTLY_SHARED)


def _joined(
    organ: Organ,
    sheets: Sequence[Sheet],
    group: list[int],
    found: Sequence[Divided],
    before: Sequence[Sequence[Earlier]],
) -> JoinedCuts:
    """Return several cuts as one."""
    cells = organ.cell_nodes
    height = found[group[0]][0].height.copy()
    for number in group:
        for divided in before[number]:
            held = np.unique(cells[divided.cells])
            height[held] = way_of(divided.height, height, held) * divided.height[held]
    others = [sheet for number, sheet in enumerate(sheets) if number not in group]
    made, ways, parts = [], [], []
    for number in group:
        beside = tuple(sheets[other] for other in group if other != number)
        earlier = before[number][0] if sheets[number].mark and before[number] else None
        part = crossing_among(organ.rest_positions, cells, sheets[number], others, earlier, Shared(height, beside))
        way = way_of(found[number][0].height, height, np.unique(cells[found[number][0].cells]))
        made.append(part)
        ways.append(way)
        crossing, samples = part
        fraction = crossing.fraction if way > 0 else 1.0 - crossing.fraction
        parts.append((crossing._replace(height=way * height, fraction=fraction), samples))
    return JoinedCuts((*group,), (*ways,), _together(made), (*parts,))


def _together(parts: Sequence[Divided]) -> Divided:
    """Return the cells that cuts with the same heights divide together."""
    chosen, first = np.unique(np.concatenate([crossing.cells for crossing, _ in parts]), return_index=True)
    coordinates, weight = (np.concatenate([samples[k] for _, samples in parts])[first] for k in (0, 1))
    covered = np.zeros(weight.shape, dtype=bool)
    for crossing, samples in parts:
        covered[np.searchsorted(chosen, crossing.cells)] |= samples.covered
    crossing = parts[0][0]
    whole = Crossing(
        cells=chosen,
        cut_fraction=rounded((weight * covered).sum(axis=1) / np.maximum(weight.sum(axis=1), 1e-300)),
        fraction=np.concatenate([crossing.fraction for crossing, _ in parts])[first],
        height=crossing.height,
        area=sum(crossing.area for crossing, _ in parts),
        advance=crossing.advance,
    )
    return whole, Samples(coordinates, weight, covered)
