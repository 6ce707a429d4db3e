"""Critical step of the assembled model: how long a substep may be."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from tissue_sim.array_types import Floats
from tissue_sim.handles import handle
from tissue_sim.model.forces import elastic_forces

if TYPE_CHECKING:
    from tissue_sim.model.assembly import Model

SAFETY = 0.9
MOST_SUBSTEPS = 10_000  # in a tick; where the critical step is shorter, only the guard is left


def largest_frequency(model: Model, iterations: int = 200, tolerance: float = 1e-4) -> float:
    """Return the largest angular frequency of the model about its rest shape.

    Power iteration on M^-1 K; K v is the central difference of the force kernels, so every kind of spring counts
    without being assembled a second time.

    Parameters
    ----------
    model : Model
        Constants of the model.
    iterations : int, optional
        Largest number of iterations.
    tolerance : float, optional
        Relative change at which it has converged.

    Returns
    -------
    float, rad/s
        The frequency.
    """
    n, held = len(model.rest), handle(model)
    root = np.sqrt(model.inverse_mass)[:, None]
    vector = root * np.random.default_rng(0).standard_normal((n, 3))
    length = float(np.ptp(model.rest, axis=0).max())
    eigenvalue = 0.0
    for _ in range(iterations):
        norm = math.sqrt(_dot(vector, vector))
        if norm == 0.0:
            return 0.0
        vector /= norm
        push = root * vector
        small = 1e-7 * length / max(float(np.abs(push).max()), 1e-300)
        product = -root * (_force(model, held, push * small) - _force(model, held, -push * small)) / (2.0 * small)
        last, eigenvalue = eigenvalue, _dot(vector, product)
        vector = product
        if abs(eigenvalue - last) <= tolerance * abs(eigenvalue):
            break
    return math.sqrt(max(eigenvalue, 0.0))


def critical_step(frequency: float, damping_ratio: float, integrator: str = "symplectic") -> float:
    """Return the longest stable step, s, for angular frequency w (rad/s) and damping ratio z.

    symplectic: symplectic Euler with implicit nodal damping, h = (2/w)(sqrt(1 + z^2) + z); explicit: forward Euler, h =
    2 z/w, none without damping, and at most 1/(w z) of an overdamped oscillator; implicit: any.
    """
    if integrator == "implicit" or frequency == 0.0:
        return math.inf
    if integrator == "symplectic":
        return 2.0 / frequency * (math.sqrt(1.0 + damping_ratio**2) + damping_ratio)
    if damping_ratio <= 1.0:
        return 2.0 * damping_ratio / frequency
    return 2.0 / frequency / (damping_ratio + math.sqrt(damping_ratio**2 - 1.0))


def stable_frequency(step: float, damping_rate: float) -> float:
    """Return the angular frequency for which a step is the critical one of symplectic Euler.

    This is the inverse of critical_step: w^2 = 4/h^2 + 2c/h.

    Parameters
    ----------
    step : float, s
        The step.
    damping_rate : float, 1/s
        Damping over mass.

    Returns
    -------
    float, rad/s
        The frequency.
    """
    return math.sqrt(4.0 / step**2 + 2.0 * damping_rate / step)


def model_step(
    model: Model,
    frequency: float,
    stiffness_scale: float = 1.0,
    damping_scale: float = 1.0,
    integrator: str = "symplectic",
) -> float:
    """Return the critical step of a model.

    Parameters
    ----------
    model : Model
        Constants of the model.
    frequency : float, rad/s
        Largest frequency, unscaled.
    stiffness_scale : float, optional
        Factor of the stiffness.
    damping_scale : float, optional
        Factor of the damping.
    integrator : str, optional
        One of INTEGRATORS.

    Returns
    -------
    float, s
        The critical step.
    """
    scaled = frequency * math.sqrt(stiffness_scale)
    moving = model.moving
    if scaled == 0.0 or not len(moving):
        return math.inf
    least_damping = damping_scale * float((model.damping[moving] * model.inverse_mass[moving]).min())
    return critical_step(scaled, least_damping / (2.0 * scaled), integrator)


def substeps_for(tick_time: float, longest_step: float) -> int:
    """Return the number of substeps of a tick so that each is below 0.9 of the critical step.

    Parameters
    ----------
    tick_time : float, s
        Duration of a tick.
    longest_step : float, s
        Critical step.

    Returns
    -------
    int
        The number, at most 10,000.
    """
    if longest_step <= SAFETY * tick_time / MOST_SUBSTEPS:
        return MOST_SUBSTEPS
    return max(1, math.ceil(tick_time / (SAFETY * longest_step)))


def _dot(one: Floats, other: Floats) -> float:
    """Return the sum of products, without BLAS, whose rounding depends on the processor, which a replay must not."""
    return float((one * other).sum())


def _force(model: Model, held: Any, displacement: Floats) -> Floats:
    force = np.zeros_like(model.rest)
    elastic_forces(held, model.rest + displacement, force)
    return force
