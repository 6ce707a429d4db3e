"""Mechanical energy of a state, for tests and benchmarks."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from tissue_sim.array_types import Floats, Ints
from tissue_sim.jit import kernel
from tissue_sim.model.data.model import Model
from tissue_sim.model.elasticity.cells import cell_energy
from tissue_sim.model.elasticity.forces import stored


class Energy(NamedTuple):
    """Kinetic and elastic energy, J."""

    kinetic: float
    elastic: float  # of springs, angular springs and return springs, or of cells; 0 at rest without load

    @property
    def total(self) -> float:
        """Sum of both, J."""
        return self.kinetic + self.elastic


def energy_of(model: Model, position: Floats, velocity: Floats) -> Energy:
    """Return the energy of a state, with the stiffness as assembled.

    Parameters
    ----------
    model : Model
        Constants of the model.
    position : Floats, shape (n, 3), m
        Positions of the nodes, surface first.
    velocity : Floats, shape (n, 3), m/s
        Velocities of the nodes.
    """
    moving = model.moving
    kinetic = 0.5 * float(np.sum(velocity[moving] ** 2 / model.inverse_mass[moving, None]))
    if model.tissue is not None:
        return Energy(kinetic, cell_energy(position, model.unloaded, model.tissue))
    ends, law = (model.spring_first, model.spring_second), (model.spring_rest_length, model.spring_stiffness)
    axial = float(_axial_energy(position, *ends, *law))
    pulled = model.return_nodes
    away = np.sum((position[pulled] - model.rest[pulled]) ** 2, axis=1)
    returning = 0.5 * float(np.sum(model.return_stiffness[pulled] * away))
    return Energy(kinetic, axial + angular_energy(model, position) + returning)


@kernel
def _axial_energy(position: Floats, first: Ints, second: Ints, rest: Floats, stiffness: Floats) -> float:
    total = 0.0
    for s in range(len(first)):
        square = 0.0
        for axis in range(3):
            square += (position[second[s], axis] - position[first[s], axis]) ** 2
        total += stiffness[s] * rest[s] * rest[s] * stored(math.sqrt(square) / rest[s])
    return total


def angular_energy(model: Model, position: Floats) -> float:
    """Return the energy k/2 (s - s0)^2 of every angular spring, J; see forces.edge_forces."""
    i, j, k, m = (position[model.angular_nodes[:, c]] for c in range(4))
    normal = np.cross(j - i, k - m)
    square = np.maximum(np.einsum("hx,hx->h", normal, normal), model.angular_least_area)
    curved = np.einsum("hc,hcx->hx", model.angular_weight, position[model.angular_nodes])
    bent = np.einsum("hx,hx->h", curved, normal) / np.sqrt(square)
    return 0.5 * float(np.sum(model.angular_stiffness * (bent - model.angular_rest) ** 2))
