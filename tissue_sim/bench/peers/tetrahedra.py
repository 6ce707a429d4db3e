"""Mesh that peers of tetrahedra share: Netgen's, exactly inside the organ's surface, without any refinement."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tissue_sim.array_types import Floats, Ints
from tissue_sim.calibration.fe_mesh import Grading, fill
from tissue_sim.organ.organ import Organ

UNGRADED = Grading(clamp=-10, near=-10)  # so large that Netgen's mesh isn't refined
PAIRS = np.array([(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)])


class Tetrahedra(NamedTuple):
    """Nodes (n, 3) m, of which the first are the organ's surface, and positively oriented cells (c, 4)."""

    nodes: Floats
    cells: Ints

    @property
    def edges(self) -> Ints:
        """Edges (e, 2) of the cells, each once."""
        return np.unique(np.sort(self.cells[:, PAIRS].reshape(-1, 2), axis=1), axis=0)

    def masses(self, density: float) -> Floats:
        """Return masses (n,) kg: a quarter of each cell's for each of its nodes."""
        quarter = np.repeat(density * volumes(self.nodes, self.cells) / 4.0, 4)
        return np.bincount(self.cells.ravel(), weights=quarter, minlength=len(self.nodes))


def tetrahedra_of(organ: Organ) -> Tetrahedra:
    """Return the mesh of an organ. Raises UserError without Netgen, and where it can't fill the surface."""
    filling = fill(organ, grading=UNGRADED)
    cells = np.ascontiguousarray(filling.elements[:, :4])
    nodes = np.ascontiguousarray(filling.nodes[: cells.max() + 1])
    turned = volumes(nodes, cells) < 0.0
    cells[turned] = cells[turned][:, [0, 2, 1, 3]]
    return Tetrahedra(nodes, cells)


def volumes(nodes: Floats, cells: Ints) -> Floats:
    """Return the signed volumes (c,) m^3."""
    return np.linalg.det(nodes[cells[:, 1:]] - nodes[cells[:, :1]]) / 6.0
