"""Critical step of the assembled model: the longest stable substep."""

from __future__ import annotations

import math

import numpy as np

from tissue_sim.model.data.model import Model
from tissue_sim.model.data.shapes import CAPSULE, SPHERE, Shapes

SAFETY = 0.9
# s, for an organ of any stiffness. In a longer step a tool with features finer than FINE, m, slips through the tissue
# that it pushes, and springs oscillate.
LONGEST_STEP = 5e-4
LONGEST_OF_CELLS = 1e-3  # with blunt tools
FINE = 1e-3
# s. In a modal region the nodes' mass is scaled so that they need no shorter step: on a fine organ the masses are tiny,
# and the frequency of their vibration can't be felt. The organ's own motion is that of its modes.
REGION_STEP = 1e-3 / 6
MAX_SUBSTEPS = 10_000  # in a tick; if the critical step is even shorter, only the guard keeps the organ in bounds


def critical_step(frequency: float, damping_ratio: float, integrator: str = "symplectic") -> float:
    """Return the longest stable step, s, for angular frequency w (rad/s) and damping ratio z.

    symplectic: symplectic Euler with implicit nodal damping, h = (2/w)(sqrt(1 + z^2) + z); explicit: forward Euler, h =
    2 z/w, none without damping, and at most 1/(w z) of an overdamped oscillator.
    """
    if frequency == 0.0:
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


def longest_step_with(shapes: Shapes, of_cells: bool) -> float:
    """Return the longest substep, s, with which tools don't slip through tissue.

    Parameters
    ----------
    shapes : Shapes
        The tools.
    of_cells : bool
        Whether the organ consists of cells, not of springs.
    """
    blunt = np.isin(shapes.kind, (SPHERE, CAPSULE)) & (shapes.size[:, 0] >= FINE)
    return LONGEST_OF_CELLS if of_cells and np.all(blunt) else LONGEST_STEP


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
    if longest_step <= SAFETY * tick_time / MAX_SUBSTEPS:
        return MAX_SUBSTEPS
    return max(1, math.ceil(tick_time / (SAFETY * longest_step)))
