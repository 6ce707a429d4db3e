"""Polygons of the surface of pieces at cuts that meet, and their shared points."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from tissue_sim.array_types import Floats, Longs
from tissue_sim.model.cutting.crossing import Crossing, section_of
from tissue_sim.model.cutting.meeting import Pieces
from tissue_sim.model.cutting.point_names import Line, Name, Names, line_of
from tissue_sim.organ.organ import Organ


class Polygon(NamedTuple):
    """Part of the surface."""

    corners: list[Name]
    nodes: Mapping[int, int]  # node of the piece for each node of the organ: itself, or a virtual node
    sides: Mapping[int, int]  # sides of the piece that has it, by sheet
    wall: int


class SurfaceBuilder:
    """Builder of the surface of pieces from polygons."""

    def __init__(self, organ: Organ, crossings: Sequence[Crossing], pieces: Pieces, first: int) -> None:
        self.organ, self.crossings, self.pieces, self.first = organ, crossings, pieces, first
        self.names = Names(organ, crossings)
        self.polygons: list[Polygon] = []
        self.gone: list[int] = []
        self.number: dict[tuple[Name, tuple[int, ...]], int] = {}
        self.points: list[tuple[list[int], list[float]]] = []
        self.named: list[Name] = []
        self.at_sides: dict[Name, list[tuple[Mapping[int, int], int]]] = defaultdict(list)
        touched = pieces.sides.any(axis=1) & pieces.bears
        self.touched = np.unique(pieces.cell[touched])
        bearing = np.flatnonzero(pieces.bears & np.isin(pieces.cell, self.touched))
        self.of_cell: dict[int, list[int]] = defaultdict(list)
        for piece in bearing.tolist():
            self.of_cell[int(pieces.cell[piece])].append(piece)

    def sides_of(self, piece: int) -> dict[int, int]:
        """Return the sides of a piece, by the sheets that divide it."""
        return {sheet: side for sheet, side in enumerate(self.pieces.sides[piece].tolist()) if side}

    def add_pieces(self, owner: Longs) -> None:
        """Gather the faces and walls of all pieces, from the cell (t,) of each triangle."""
        faces: dict[int, list[int]] = defaultdict(list)
        for triangle in np.flatnonzero(np.isin(owner, self.touched)).tolist():
            faces[int(owner[triangle])].append(triangle)
            self.gone.append(triangle)
        triangles = self.organ.surface_triangles
        sections = [self._sections(sheet) for sheet in range(len(self.crossings))]
        for cell, pieces in self.of_cell.items():
            corners = self.organ.cell_nodes[cell].tolist()
            for piece in pieces:
                nodes = dict(zip(corners, self.pieces.nodes[piece].tolist(), strict=True))
                sides = self.sides_of(piece)
                for triangle in faces[cell]:
                    whole: list[Name] = [((node,), ()) for node in triangles[triangle].tolist()]
                    self._add(Polygon(self.names.clipped(whole, sides), nodes, sides, 0))
                for sheet, side in sides.items():
                    section = sections[sheet][cell][::side]
                    others = {other: way for other, way in sides.items() if other != sheet}
                    self._add(Polygon(self.names.clipped(section, others), nodes, sides, sheet + 1))

    def _sections(self, sheet: int) -> dict[int, list[Name]]:
        """Return the sections of divided cells, whose normals point to the negative side."""
        cells = self.crossings[sheet].cells
        cells = cells[np.isin(cells, self.touched)]
        quads = self.organ.cell_nodes[cells].astype(np.int64)
        pairs = section_of(self.crossings[sheet].positive[quads])
        ends = np.sort(np.take_along_axis(quads[:, None, :], pairs, axis=2), axis=2)
        found = {}
        for cell, corners in zip(cells.tolist(), ends.tolist(), strict=True):
            named: list[Name] = [(tuple(pair), (sheet,)) for pair in corners]
            found[cell] = list(dict.fromkeys(named))
        return found

    def _add(self, polygon: Polygon) -> None:
        if len(polygon.corners) > 2:
            self.polygons.append(polygon)

    def lines(self) -> dict[Line, set[Name]]:
        """Return the points inside each line: where a sheet crosses an edge, or the line of another sheet in a face."""
        found: dict[Line, set[Name]] = defaultdict(set)
        for polygon in self.polygons:
            for name in polygon.corners:
                nodes, sheets = name
                if len(nodes) == 2:
                    found[(nodes, ())].add(name)
                elif len(nodes) == 3:
                    for sheet in sheets:
                        found[(nodes, (sheet,))].add(name)
        return found

    def filled_in(self, polygon: Polygon, lines: Mapping[Line, set[Name]]) -> Polygon:
        """Return a polygon with all points that neighbours have on its sides."""
        corners: list[Name] = []
        for k, name in enumerate(polygon.corners):
            after = polygon.corners[(k + 1) % len(polygon.corners)]
            corners.append(name)
            line = line_of(name, after)
            inner = [one for one in lines.get(line, ()) if one not in (name, after)]
            if inner:
                start, end = (self._on(line, one) for one in (name, after))
                way = end - start
                along = [float((self._on(line, one) - start) @ way / (way @ way)) for one in inner]
                corners += [one for at, one in sorted(zip(along, inner, strict=True)) if 0.0 < at < 1.0]
        return polygon._replace(corners=corners)

    def _on(self, line: Line, name: Name) -> Floats:
        """Return the weights of a line's nodes at a point on it."""
        found = np.zeros(len(line[0]))
        found[[line[0].index(node) for node in name[0]]] = self.names.weights(name)
        return found

    def is_on(self, node: int, sheet: int, side: int) -> bool:
        """Return whether a node is on a side of a sheet."""
        return bool(self.crossings[sheet].positive[node]) == (side > 0)

    def is_open(self, name: Name) -> bool:
        """Return whether there are different points at one place on both sides of its sheet."""
        (sheet, *_) = name[1]
        sides = [{number for have, number in self.at_sides[name] if have.get(sheet, 0) == way} for way in (1, -1)]
        return bool(sides[0]) and bool(sides[1]) and not sides[0] & sides[1]

    def known(self, name: Name, sides: Mapping[int, int]) -> int | None:
        """Return the index of a point on given sides of the sheets; None if it has none yet."""
        for have, number in self.at_sides.get(name, ()):
            if all(have.get(sheet, side) == side for sheet, side in sides.items()):
                return number
        return None

    def standing(self, cell: int, sides: Mapping[int, int]) -> list[list[int]]:
        """Return the nodes of the pieces of a cell that may be on given sides of the sheets."""
        if cell not in self.of_cell:
            return [self.organ.cell_nodes[cell].tolist()]
        fit = [
            piece
            for piece in self.of_cell[cell]
            if all(sides.get(sheet, side) == side for sheet, side in self.sides_of(piece).items())
        ]
        return [self.pieces.nodes[piece].tolist() for piece in fit]

    def point(self, name: Name, polygon: Polygon) -> int:
        """Return the index of a point of a polygon, shared by polygons with the same nodes there."""
        nodes, sheets = name
        if not sheets:
            return nodes[0]
        if not polygon.nodes:  # of a triangle without a cell
            found = self.known(name, polygon.sides)
            if found is not None:
                return found
        there = tuple(polygon.nodes.get(node, node) for node in nodes)
        return self.place(name, there, self.names.weights(name).tolist(), polygon.sides)

    def place(self, name: Name, nodes: tuple[int, ...], weights: list[float], sides: Mapping[int, int]) -> int:
        """Return the index of the point with a name that lies between given nodes."""
        key = name, nodes
        if key not in self.number:
            self.number[key] = self.first + len(self.points)
            more = 4 - len(nodes)
            self.points.append((list(nodes) + more * [nodes[-1]], weights + more * [0.0]))
            self.named.append(name)
        found = self.number[key]
        self.at_sides[name].append((sides, found))
        return found

    def triangles_of(self, polygon: Polygon) -> list[list[int]]:
        """Return triangles of a polygon, the same for the one on the other side of its wall."""
        corners = polygon.corners
        count = len(corners)
        # The order is the same for both sides: from the lowest name on, towards its lower neighbour.
        start = corners.index(min(corners))
        turned = corners[start - 1] < corners[(start + 1) % count]
        order = [(start + (-k if turned else k)) % count for k in range(count)]
        apex = 0 if count == 3 else _apex([self.names.place(corners[k]) for k in order])
        ids = [self.point(corners[k], polygon) for k in order]
        ids = ids[apex:] + ids[:apex]
        triangles = [[ids[0], ids[k], ids[k + 1]] for k in range(1, count - 1)]
        return [triangle[::-1] for triangle in triangles] if turned else triangles

    def partners(self) -> tuple[Longs, Longs]:
        """Return the partner (q,) and the side (q,) of each point; see CutSurface."""
        count = len(self.points)
        partner, side = self.first + np.arange(count), np.zeros(count, dtype=np.int64)
        for (nodes, sheets), found in self.at_sides.items():
            if len(nodes) != 2:
                continue
            (sheet,) = sheets
            ways: dict[int, list[int]] = {
                way: [number for sides, number in found if sides.get(sheet, 0) == way] for way in (1, -1)
            }
            if not ways[1] or not ways[-1] or {*ways[1]} & {*ways[-1]}:
                continue
            for way in (1, -1):
                for number in ways[way]:
                    partner[number - self.first], side[number - self.first] = ways[-way][0], way
        return partner, side


def _apex(place: list[tuple[float, ...]]) -> int:
    """Return the corner of a convex polygon whose fan of triangles has the largest smallest triangle."""
    count, best, apex = len(place), -1.0, 0
    for k in range(count):
        least = np.inf
        for m in range(1, count - 1):
            (a, b, c), (d, e, f) = (
                [x - y for x, y in zip(place[(k + m + more) % count], place[k], strict=True)] for more in (0, 1)
            )
            least = min(least, (b * f - c * e) ** 2 + (c * d - a * f) ** 2 + (a * e - b * d) ** 2)
        if least > best * (1.0 + 1e-9):
            best, apex = least, k
    return apex
