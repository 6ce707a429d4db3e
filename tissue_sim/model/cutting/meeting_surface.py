"""The surface of an organ at cuts that meet: faces of cells and walls, clipped by every sheet that crosses them."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import NamedTuple

import numpy as np

from tissue_sim.array_types import Floats, Longs
from tissue_sim.model.cutting.crossing import Crossing
from tissue_sim.model.cutting.meeting import Pieces
from tissue_sim.model.cutting.point_names import Line, Name
from tissue_sim.model.cutting.surface_builder import Polygon, SurfaceBuilder
from tissue_sim.organ.organ import Organ

_PAIRS = ((0, 1), (1, 2), (0, 2))


class SurfacePart(NamedTuple):
    """Points and triangles at cuts that meet; see CutSurface. q points, r triangles."""

    nodes: Longs  # (q, 4)
    weights: Floats  # (q, 4)
    triangles: Longs  # (r, 3)
    wall: Longs  # (r,) 0 for the outer surface, otherwise the index of the sheet among those given, plus 1
    partner: Longs  # (q,)
    side: Longs  # (q,)
    rank: Longs  # (q,) the same for points at the same place
    gone: Longs  # triangles of the organ's surface that these replace


def meeting_surface(
    organ: Organ, crossings: Sequence[Crossing], pieces: Pieces, owner: Longs, first: int
) -> SurfacePart:
    """Return the surface of an organ at cuts that meet.

    Parameters
    ----------
    organ : Organ
        The organ before its cuts.
    crossings : Sequence[Crossing]
        The cells that each sheet divides.
    pieces : Pieces
        Pieces into which these are divided.
    owner : Longs, shape (t,)
        The cell of each triangle of the surface, -1 where there is none, as it would be too flat.
    first : int
        Number of the first point.

    Returns
    -------
    SurfacePart
        Points and triangles that replace those there.
    """
    builder = SurfaceBuilder(organ, crossings, pieces, first)
    builder.add_pieces(owner)
    lines = builder.lines()
    triangles: list[list[int]] = []
    wall: list[int] = []

    def write(polygon: Polygon) -> None:
        made = builder.triangles_of(builder.filled_in(polygon, lines))
        triangles.extend(made)
        wall.extend(len(made) * [polygon.wall])

    for polygon in builder.polygons:
        write(polygon)
    for polygon in [*_FlatCells(builder, owner, lines).polygons(), *_beside(builder, lines)]:
        write(polygon)
    kept = _apart(triangles)
    partner, side = builder.partners()
    names = {name: rank for rank, name in enumerate(dict.fromkeys(builder.named))}
    return SurfacePart(
        nodes=np.array([nodes for nodes, _ in builder.points], dtype=np.int64).reshape(-1, 4),
        weights=np.array([weights for _, weights in builder.points]).reshape(-1, 4),
        triangles=np.array(triangles, dtype=np.int64).reshape(-1, 3)[kept],
        wall=np.array(wall, dtype=np.int64)[kept],
        partner=partner,
        side=side,
        rank=np.array([names[name] for name in builder.named], dtype=np.int64),
        gone=np.array(sorted(builder.gone), dtype=np.int64),
    )


def _apart(triangles: list[list[int]]) -> list[int]:
    """Return which triangles are kept: all but those on both sides of a wall whose sides meet in all corners."""
    found: dict[tuple[int, ...], list[int]] = {}
    for number, (a, b, c) in enumerate(triangles):
        opposite = found.get(min((a, c, b), (c, b, a), (b, a, c)))
        if opposite:
            opposite.pop()
        else:
            found.setdefault(min((a, b, c), (b, c, a), (c, a, b)), []).append(number)
    return sorted(number for numbers in found.values() for number in numbers)


def _beside(builder: SurfaceBuilder, lines: dict[Line, set[Name]]) -> list[Polygon]:
    """Return the triangles of undivided cells that have points of cuts on their edges."""
    gone, found = set(builder.gone), []
    ends = {nodes for nodes, sheets in lines if not sheets}
    for number, corners in enumerate(builder.organ.surface_triangles.tolist()):
        if number in gone:
            continue
        if any(tuple(sorted((corners[a], corners[b]))) in ends for a, b in _PAIRS):
            whole: list[Name] = [((node,), ()) for node in corners]
            found.append(Polygon(whole, {node: node for node in corners}, {}, 0))
            builder.gone.append(number)
    return found


class _FlatCells:
    """Triangles without a cell, as it would be too flat: cuts continue through them, but no cell moves their points."""

    def __init__(self, builder: SurfaceBuilder, owner: Longs, lines: dict[Line, set[Name]]) -> None:
        self.builder, self.lines = builder, lines
        organ = builder.organ
        cells = organ.cell_nodes.astype(np.int64)
        flat = np.flatnonzero(owner < 0)
        near = np.isin(organ.surface_triangles[flat], cells[builder.touched]).any(axis=1)
        self.corners = {number: organ.surface_triangles[number].tolist() for number in flat[near].tolist()}
        nodes = np.unique(organ.surface_triangles[flat[near]])
        around = cells[np.isin(cells, nodes).any(axis=1)]
        self.joined = {(min(a, b), max(a, b)) for quad in around.tolist() for i, a in enumerate(quad) for b in quad[:i]}

    def polygons(self) -> list[Polygon]:
        """Return the polygons that replace them."""
        through = self._through()
        found = []
        for number, sheets in through.items():
            self.builder.gone.append(number)
            corners = self.corners[number]
            for edge in self._edges(number):
                for sheet in sheets:
                    if self._crosses(edge, sheet):
                        self.lines[(edge, ())].add((edge, (sheet,)))
            whole: list[Name] = [((node,), ()) for node in corners]
            for ways in product((1, -1), repeat=len(sheets)):
                sides = dict(zip(sorted(sheets), ways, strict=True))
                clipped = self.builder.names.clipped(whole, sides)
                if len(clipped) > 2:
                    for name in clipped:
                        self._settle(name, sides)
                    found.append(Polygon(clipped, {}, sides, 0))
        return found

    def _edges(self, number: int) -> list[tuple[int, int]]:
        corners = self.corners[number]
        return [(min(corners[a], corners[b]), max(corners[a], corners[b])) for a, b in _PAIRS]

    def _crosses(self, edge: tuple[int, int], sheet: int) -> bool:
        positive = self.builder.crossings[sheet].positive
        return bool(positive[edge[0]] != positive[edge[1]])

    def _through(self) -> dict[int, set[int]]:
        """Return the sheets that split each triangle: open at one of its edges, or continued from another triangle."""
        found: dict[int, set[int]] = {}
        open_ = {name for name in self.builder.at_sides if self.builder.is_open(name)}
        while True:
            before = sum(map(len, found.values()))
            for number in self.corners:
                for edge in self._edges(number):
                    for sheet in range(len(self.builder.crossings)):
                        if self._crosses(edge, sheet) and (edge, (sheet,)) in open_:
                            found.setdefault(number, set()).add(sheet)
            for number, sheets in found.items():
                open_ |= {
                    (edge, (sheet,))
                    for edge in self._edges(number)
                    for sheet in sheets
                    if edge not in self.joined and self._crosses(edge, sheet)
                }
            if sum(map(len, found.values())) == before:
                return found

    def _settle(self, name: Name, sides: dict[int, int]) -> None:
        """Assign nodes on given sides of the sheets to a point."""
        nodes, sheets = name
        builder = self.builder
        if not sheets or builder.known(name, sides) is not None:
            return
        if len(nodes) == 2 and nodes in self.joined:  # undivided cells are around it
            builder.place(name, nodes, builder.names.weights(name).tolist(), {})
            return
        own = [node for node in nodes if all(builder.is_on(node, sheet, sides[sheet]) for sheet in sheets)] or nodes
        where = np.array(builder.names.place(name))
        best: tuple[float, list[int], list[float]] = (-np.inf, [], [])
        organ = builder.organ
        for cell in np.flatnonzero(np.isin(organ.cell_nodes, own).any(axis=1)).tolist():
            corner = organ.rest_positions[organ.cell_nodes[cell]]
            inner = np.linalg.solve((corner[1:] - corner[0]).T, where - corner[0])
            weights = [1.0 - float(inner.sum()), *inner.tolist()]
            for nodes_there in builder.standing(cell, sides):
                if min(weights) > best[0]:
                    best = min(weights), nodes_there, weights
        builder.place(name, tuple(best[1]), best[2], sides)
