"""How long a substep may be: the critical step of the assembled model."""

from __future__ import annotations

import math

import numpy as np

from tissue_sim.model.assembly import Model
from tissue_sim.model.state import Floats
from tissue_sim.model.tick import elastic_forces

SAFETY = 0.9


def largest_frequency(model: Model, iterations: int = 200, tolerance: float = 1e-4) -> float:
    """Largest angular frequency of the model about its rest shape, rad/s.

    Power iteration on M^-1 K; K v is the central difference of the force kernels, so every kind
    of spring counts without being assembled a second time.
    """
    n = len(model.rest)
    root = np.sqrt(model.inverse_mass)[:, None]
    vector = root * np.random.default_rng(0).standard_normal((n, 3))
    length = float(np.ptp(model.rest, axis=0).max())
    eigenvalue = 0.0
    for _ in range(iterations):
        norm = np.linalg.norm(vector)
        if norm == 0.0:
            return 0.0
        vector /= norm
        push = root * vector
        small = 1e-7 * length / max(float(np.abs(push).max()), 1e-300)
        product = -root * (_force(model, push * small) - _force(model, -push * small)) / (2.0 * small)
        last, eigenvalue = eigenvalue, float(np.vdot(vector, product))
        vector = product
        if abs(eigenvalue - last) <= tolerance * abs(eigenvalue):
            break
    return math.sqrt(max(eigenvalue, 0.0))


def critical_step(frequency: float, damping_ratio: float) -> float:
    """Longest stable step, s, of symplectic Euler with implicit nodal damping.

    h = (2/w)(sqrt(1 + z^2) + z) for angular frequency w (rad/s) and damping ratio z.
    """
    if frequency == 0.0:
        return math.inf
    return 2.0 / frequency * (math.sqrt(1.0 + damping_ratio**2) + damping_ratio)


def substeps_for(model: Model, tick_time: float, stiffness_scale: float, frequency: float) -> int:
    """Substeps in a tick of tick_time s so that each is under 0.9 of the critical step."""
    scaled = frequency * math.sqrt(stiffness_scale)
    moving = model.moving
    if scaled == 0.0 or not len(moving):
        return 1
    least_damping = float((model.damping[moving] * model.inverse_mass[moving]).min())
    step = SAFETY * critical_step(scaled, least_damping / (2.0 * scaled))
    return max(1, math.ceil(tick_time / step))


def _force(model: Model, displacement: Floats) -> Floats:
    force = np.zeros_like(model.rest)
    elastic_forces(model, model.rest + displacement, force)
    return force
