"""Names of points on the surface of an organ at cuts that meet, and convex polygons of them.

A point is named by the nodes between which it lies and the sheets on which it lies: a node itself, an edge that a sheet
crosses, a face that two sheets cross, a cell that three cross. Its coordinates depend on these alone, so that pieces of
neighbouring cells agree to the last bit.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from tissue_sim.array_types import Floats
from tissue_sim.errors import UserError
from tissue_sim.model.cutting.crossing import Crossing
from tissue_sim.organ.organ import Organ

PARALLEL = 1e-9  # sum of the minors of two sheets' heights, relative to their sizes, below which they are parallel

PARTLY_SHARED = "the cut lies partly in the surface of an earlier one; move it by a millimetre, or keep to it"

Name = tuple[tuple[int, ...], tuple[int, ...]]  # nodes between which a point lies, and sheets on which it lies
Line = tuple[tuple[int, ...], tuple[int, ...]]  # an edge; or a face and a sheet, whose intersection the line is


class Names:
    """Coordinates of points by their names, and their sides of each sheet.

    Parameters
    ----------
    organ : Organ
        The organ.
    crossings : Sequence[Crossing]
        The cells that each sheet divides.
    """

    def __init__(self, organ: Organ, crossings: Sequence[Crossing]) -> None:
        self.rest = organ.rest_positions
        self._height = [crossing.height for crossing in crossings]
        self._weights: dict[Name, Floats] = {}
        self._place: dict[Name, tuple[float, ...]] = {}

    def weights(self, name: Name) -> Floats:
        """Return the weights of a point's nodes, in their order."""
        found = self._weights.get(name)
        if found is None:
            nodes, sheets = name
            at = np.array([self._height[sheet][list(nodes)] for sheet in sheets]).reshape(len(sheets), len(nodes))
            if len(nodes) == 2:
                part = at[0, 0] / (at[0, 0] - at[0, 1])
                found = np.array([1.0 - part, part])
            else:
                # The weights are orthogonal to all heights: the minors of their matrix, with alternating signs.
                signs = (-1.0) ** np.arange(len(nodes))
                minors = [np.linalg.det(np.delete(at, k, axis=1)) for k in range(len(nodes))] if sheets else [1.0]
                found = signs * minors
                total = found.sum()
                if not abs(total) > PARALLEL * np.abs(found).sum():
                    raise UserError(PARTLY_SHARED)
                found = found / total
            self._weights[name] = found
        return found

    def height(self, name: Name, sheet: int) -> float:
        """Return the height of a point above a sheet, linear between its nodes."""
        return float(self.weights(name) @ self._height[sheet][list(name[0])])

    def place(self, name: Name) -> tuple[float, ...]:
        """Return the position of a point at rest, (3,) m."""
        if name not in self._place:
            self._place[name] = tuple((self.weights(name) @ self.rest[list(name[0])]).tolist())
        return self._place[name]

    def clipped(self, polygon: list[Name], sides: Mapping[int, int]) -> list[Name]:
        """Return the part of a convex polygon that is on given sides of sheets; empty if there is none."""
        for sheet, side in sides.items():
            up = [(side * self.height(name, sheet)) > 0.0 for name in polygon]
            if all(up):
                continue
            made: list[Name] = []
            for k, name in enumerate(polygon):
                after = (k + 1) % len(polygon)
                if up[k]:
                    made.append(name)
                if up[k] != up[after]:
                    nodes, on = line_of(name, polygon[after])
                    made.append((nodes, tuple(sorted((*on, sheet)))))
            polygon = made
        return polygon


def line_of(one: Name, other: Name) -> Line:
    """Return the line that two neighbouring corners of a polygon lie on."""
    return tuple(sorted({*one[0], *other[0]})), tuple(sorted({*one[1]} & {*other[1]}))
