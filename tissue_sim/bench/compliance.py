"""Precomputed compliance: displacements of the surface as one matrix product with the forces on it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.linalg import splu

from tissue_sim.array_types import Floats
from tissue_sim.bench.timing import time_calls
from tissue_sim.model.data.model import Model
from tissue_sim.model.elasticity.modes import free_axes, stiffness_matrix

AT_ONCE = 300  # columns solved together


def surface_compliance(model: Model, nodes: NDArray[np.int64]) -> NDArray[np.float32]:
    """Return the compliance of the model at rest: surface displacements for unit forces on nodes.

    It is the inverse of the tangent stiffness, kept in single precision as such products are.

    nodes (k,): loaded nodes. Returns (3 n_surface, 3 k) m/N.
    """
    free = free_axes(model)
    place = np.full(3 * len(model.rest), -1, dtype=np.int64)
    place[free] = np.arange(len(free))
    factors = splu(stiffness_matrix(model)[free][:, free], permc_spec="MMD_AT_PLUS_A")
    columns = place[(3 * nodes[:, None] + np.arange(3)).ravel()]
    surface = place[: 3 * model.n_surface]
    answer = np.zeros((len(surface), len(columns)), dtype=np.float32)
    for first in range(0, len(columns), AT_ONCE):
        part = np.arange(first, min(first + AT_ONCE, len(columns)))
        part = part[columns[part] >= 0]  # a held node stays where it is
        unit = np.zeros((len(free), len(part)))
        unit[columns[part], np.arange(len(part))] = 1.0
        answer[np.ix_(surface >= 0, part)] = factors.solve(unit)[surface[surface >= 0]]
    return answer


class Product:
    """Bursts of displacements = compliance (3 n, 3 k) times forces (k, 3) N, in single precision."""

    def __init__(self, compliance: NDArray[np.float32], forces: Floats) -> None:
        self.compliance = compliance
        self.forces = np.ascontiguousarray(forces, dtype=np.float32).ravel()
        self.displacement = np.zeros(len(compliance), dtype=np.float32)

    def __call__(self, count: int) -> Floats:
        """Return the seconds (count,) of `count` products."""
        return time_calls(lambda: np.dot(self.compliance, self.forces, out=self.displacement), count)
