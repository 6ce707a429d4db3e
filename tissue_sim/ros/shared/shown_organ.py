"""What is shown of an organ: its nodes, and the points that its surface has more since it was cut."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tissue_sim.array_types import Floats, Ints, Longs
from tissue_sim.model.cutting.cut_surface import CutSurface
from tissue_sim.model.simulation import Simulation
from tissue_sim.organ.organ import Organ


@dataclass(frozen=True)
class ShownOrgan:
    """Rows that stand for an organ: the nodes that it had before it was cut, then the points of its walls.

    organ: with its virtual nodes; surface: None where it isn't cut.
    """

    organ: Organ
    surface: CutSurface | None = None

    @classmethod
    def of(cls, simulation: Simulation) -> ShownOrgan:
        """Return what is shown of a simulation's organ."""
        cut = simulation.cut_organ
        return cls(simulation.organ, None if cut is None else cut.surface)

    @property
    def n_rows(self) -> int:
        """Number of rows."""
        return self.organ.n_uncut + self.n_points - self.organ.n_surface

    @property
    def n_points(self) -> int:
        """Number of the surface's points."""
        return self.organ.n_surface if self.surface is None else len(self.surface.nodes)

    @property
    def triangles(self) -> Ints:
        """Triangles of the surface, (t, 3) of its points: the surface nodes, then the walls' points."""
        return self.organ.surface_triangles if self.surface is None else self.surface.triangles

    @property
    def triangle_rows(self) -> Longs:
        """The same (t, 3), of rows."""
        triangles, n = self.triangles.astype(np.int64), self.organ.n_surface
        rows: Longs = np.where(triangles < n, triangles, triangles + self.organ.n_uncut - n)
        return rows

    @property
    def rest(self) -> Floats:
        """Rest positions of the rows, (r, 3) m."""
        rows = np.zeros((self.n_rows, 3))
        self.fill(rows, self.organ.rest_positions)
        return rows

    def fill(self, rows: Floats, nodes: Floats) -> None:
        """Write what the rows have of something that nodes have: positions, or places on a colour scale.

        rows (r, ...): the rows (updated); nodes (n, ...): of all nodes.
        """
        own, surface = self.organ.n_uncut, self.surface
        rows[:own] = nodes[:own]
        if surface is not None:
            first = self.organ.n_surface
            rows[own:] = np.einsum("pk,pk...->p...", surface.weights[first:], nodes[surface.nodes[first:]])

    def points(self, rows: Floats) -> Floats:
        """Return the surface's points (p, 3) of the rows (r, 3), as the triangles count them."""
        first = self.organ.n_surface
        if self.surface is None:
            return rows[:first]
        return np.concatenate([rows[:first], rows[self.organ.n_uncut :]])
