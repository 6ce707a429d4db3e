"""How long a substep may be: the critical step of the assembled model."""

from __future__ import annotations

import math

from tissue_sim.model.model import Model

SAFETY = 0.9
MOST_SUBSTEPS = 10_000  # in a tick; where the critical step is shorter, the guard has to hold


def critical_step(frequency: float, damping_ratio: float, integrator: str = "symplectic") -> float:
    """Longest stable step, s, for angular frequency w (rad/s) and damping ratio z.

    symplectic: symplectic Euler with implicit nodal damping, h = (2/w)(sqrt(1 + z^2) + z); explicit: forward Euler,
    h = 2 z/w, none without damping, and 1/(w z) of an overdamped oscillator at most; implicit: any.
    """
    if integrator == "implicit" or frequency == 0.0:
        return math.inf
    if integrator == "symplectic":
        return 2.0 / frequency * (math.sqrt(1.0 + damping_ratio**2) + damping_ratio)
    if damping_ratio <= 1.0:
        return 2.0 * damping_ratio / frequency
    return 2.0 / frequency / (damping_ratio + math.sqrt(damping_ratio**2 - 1.0))


def stable_frequency(step: float, damping_rate: float) -> float:
    """Angular frequency, rad/s, of which a step s is the critical one of symplectic Euler; damping over mass, 1/s.

    The other way around than critical_step: w^2 = 4/h^2 + 2c/h.
    """
    return math.sqrt(4.0 / step**2 + 2.0 * damping_rate / step)


def model_step(
    model: Model,
    frequency: float,
    stiffness_scale: float = 1.0,
    damping_scale: float = 1.0,
    integrator: str = "symplectic",
) -> float:
    """Critical step, s, of a model with a largest frequency of rad/s and scaled stiffness and damping."""
    scaled = frequency * math.sqrt(stiffness_scale)
    moving = model.moving
    if scaled == 0.0 or not len(moving):
        return math.inf
    least_damping = damping_scale * float((model.damping[moving] * model.inverse_mass[moving]).min())
    return critical_step(scaled, least_damping / (2.0 * scaled), integrator)


def substeps_for(tick_time: float, longest_step: float) -> int:
    """Substeps in a tick of tick_time s so that each is under 0.9 of the critical step, s; 10,000 at the most."""
    if longest_step <= SAFETY * tick_time / MOST_SUBSTEPS:
        return MOST_SUBSTEPS
    return max(1, math.ceil(tick_time / (SAFETY * longest_step)))
