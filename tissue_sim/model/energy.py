"""Mechanical energy of a state: what tests and benchmarks watch."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tissue_sim.model.assembly import Model
from tissue_sim.model.forces import HARDENING_STRAIN, SHORTEST
from tissue_sim.organ.organ import Floats


class Energy(NamedTuple):
    """J."""

    kinetic: float
    elastic: float  # of springs, angular springs and return springs; 0 at rest

    @property
    def total(self) -> float:
        """J, of both."""
        return self.kinetic + self.elastic


def energy_of(model: Model, position: Floats, velocity: Floats) -> Energy:
    """Energy of nodes at position (n, 3) m moving at velocity (n, 3) m/s, with the stiffness as assembled."""
    moving = model.moving
    kinetic = 0.5 * float(np.sum(velocity[moving] ** 2 / model.inverse_mass[moving, None]))
    rest = model.spring_rest_length
    stretch = np.linalg.norm(position[model.spring_second] - position[model.spring_first], axis=1) / rest
    stored = stored_energy(stretch, model.hardening)
    axial = float(np.sum(model.spring_stiffness * rest**2 * stored))
    pulled = model.return_nodes
    away = np.sum((position[pulled] - model.return_target[pulled]) ** 2, axis=1)
    returning = 0.5 * float(np.sum(model.return_stiffness[pulled] * away))
    return Energy(kinetic, axial + angular_energy(model, position) + returning)


def secant(strain: Floats, hardening: float) -> Floats:
    """As forces.secant, of an array."""
    s = np.clip(strain / HARDENING_STRAIN, -1.0, 1.0)
    factor: Floats = 1.0 + hardening * s * (s - 1.0)
    return factor


def stored_energy(stretch: Floats, hardening: float) -> Floats:
    """Energy of axial springs of some stretch l / l0 over k l0^2: the integral of what forces.spring_forces pulls."""
    strain = np.maximum(stretch, SHORTEST) - 1.0
    near = np.clip(strain, -HARDENING_STRAIN, HARDENING_STRAIN)
    stored = 0.5 * near**2 + hardening * near**3 * (0.25 * near / HARDENING_STRAIN - 1.0 / 3.0) / HARDENING_STRAIN
    stored += 0.5 * secant(strain, hardening) * (strain**2 - near**2)
    # Under the shortest length the push is proportional to it.
    push = (1.0 / SHORTEST - 1.0) * secant(np.full_like(stretch, SHORTEST - 1.0), hardening)
    total: Floats = stored - 0.5 * push * np.minimum(stretch**2 - SHORTEST**2, 0.0)
    return total


def angular_energy(model: Model, position: Floats) -> float:
    """k/2 (s - s0)^2 of every angular spring, J; forces.edge_forces has the law."""
    i, j, k, m = (position[model.angular_nodes[:, c]] for c in range(4))
    normal = np.cross(j - i, k - m)
    square = np.maximum(np.einsum("hx,hx->h", normal, normal), model.angular_least_area)
    curved = np.einsum("hc,hcx->hx", model.angular_weight, position[model.angular_nodes])
    bent = np.einsum("hx,hx->h", curved, normal) / np.sqrt(square)
    return 0.5 * float(np.sum(model.angular_stiffness * (bent - model.angular_rest) ** 2))
