"""Coarse steps: an organ that no hand is near takes half as many substeps, with larger masses.

The loads of such an organ, from ligaments, its neighbours and breathing, change slowly compared with its lowest modes:
its shape is nearly the static one, whatever its masses are. So the mass of each node is increased as far as a substep
of twice the length requires (selective mass scaling), which Gershgorin's circles bound. Stiffness, weight and nodal
damping are unchanged, and with them the static shape and the lag behind a load; only the inertial part of the motion
grows. An organ that a hand touches, that a tool is near, or that moves fast takes all of its substeps.

References
----------
Olovsson et al. 2005, selective mass scaling.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from tissue_sim.array_types import Floats, Longs
from tissue_sim.jit import kernel
from tissue_sim.model.contact.volume_limit import has_compressed_cells
from tissue_sim.model.data.model import Model
from tissue_sim.model.data.scratch import Plan
from tissue_sim.model.data.settings import Integrator, Settings
from tissue_sim.model.data.state import Region, State
from tissue_sim.model.data.world import World
from tissue_sim.model.elasticity.frequency import largest_frequency
from tissue_sim.model.elasticity.modes import free_axes, stiffness_matrix
from tissue_sim.model.elasticity.stiffening import shortening_of
from tissue_sim.model.stepping.critical_step import LONGEST_OF_CELLS, SAFETY
from tissue_sim.model.stepping.wake_threshold import rounded_up

CALM_SPEED = 5e-3  # m/s, of any coordinate: a slowly changing load doesn't move a node faster
ROOM = 1.01  # factor on the required step, so that it is stable despite rounding
MAX_LINK_FRACTION = (
    0.5  # largest fraction of a step's squared frequency that links may take up; beyond, no coarse steps
)
ROUNDING = 1e-9  # of a step
FRACTIONS = np.linspace(0.1, 1.0, 19)  # of the mass that Gershgorin's circles require; the smallest stable one is used


class Coarse(NamedTuple):
    """Coarse steps of k organs; the factors on their masses are in Scratch.coarse."""

    square: Floats  # (k,) (rad/s)^2, squared largest frequency with these masses; 0: no coarse steps
    ticks: Longs  # (k,) number of ticks of each in coarse steps


def no_coarse(count: int) -> Coarse:
    """Return `count` organs that take all of their substeps."""
    return Coarse(np.zeros(count), np.zeros(count, dtype=np.int64))


def coarse_masses(model: Model, settings: Settings, added: float) -> tuple[Floats, float]:
    """Return the masses with which an organ of cells can take half of its present substeps.

    Parameters
    ----------
    model : Model
        Constants of the model.
    settings : Settings
        Settings of the simulation.
    added : float, (rad/s)^2
        Largest increase of the squared largest frequency by links.

    Returns
    -------
    tuple[Floats, float]
        Factors (n,) on the nodes' masses, and the largest frequency with these, rad/s; 0 where there are no coarse
        steps: for springs, tissue that relaxes, integrators other than the symplectic one, links that are too stiff,
        and a tick of one substep.
    """
    factor = np.ones(len(model.rest))
    tick_time, substeps = float(settings.tick_time), int(settings.substeps)
    fewer = max(math.ceil(substeps / 2), min_substeps_of(tick_time))
    elastic = model.tissue is not None and len(model.relaxation) == 0
    if fewer >= substeps or not elastic or settings.integrator != Integrator.SYMPLECTIC:
        return factor, 0.0
    allowed = (2.0 * SAFETY * fewer / tick_time) ** 2
    if added > MAX_LINK_FRACTION * allowed:
        return factor, 0.0
    return masses_for(model, 2.0 * ROOM * math.sqrt(settings.stiffness_scale / (allowed - added)))


def masses_for(model: Model, step: float) -> tuple[Floats, float]:
    """Return the masses with which a substep is stable.

    The factors are rounded up to two digits, so that libraries that round differently on another processor give the
    same ones, and replays the same bits.

    Parameters
    ----------
    model : Model
        Constants of the model.
    step : float, s
        The substep.

    Returns
    -------
    tuple[Floats, float]
        Factors (n,) on the nodes' masses, and the largest frequency with these, rad/s.
    """
    free = free_axes(model)
    circles = np.asarray(abs(stiffness_matrix(model)[free][:, free]).sum(axis=1)).reshape(-1, 3).max(axis=1)
    needed = 0.25 * step**2 * circles * model.inverse_mass[model.moving]
    factor, found = np.ones(len(model.rest)), math.inf
    for fraction in FRACTIONS:
        factor[model.moving] = [rounded_up(max(1.0, value)) for value in fraction * needed]
        found = largest_frequency(model._replace(inverse_mass=model.inverse_mass / factor))
        if found * step <= 2.0:
            break
    return factor, found


@kernel
def min_substeps_of(tick_time: float) -> int:
    """Return the smallest number of substeps in a tick, s, with steps no longer than cells allow."""
    return max(1, math.ceil((1.0 - ROUNDING) * tick_time / LONGEST_OF_CELLS))


@kernel
def plan_coarse(world: World, coarse: Coarse, organ: int, added: float) -> None:
    """Plan coarse steps for an organ that may take them in this tick.

    Parameters
    ----------
    world : World
        World of the organ; updated.
    coarse : Coarse
        Coarse steps of the organs.
    organ : int
        Index of the organ.
    added : float, (rad/s)^2
        Largest increase of its squared largest frequency by links.
    """
    settings, plan = world.settings, world.scratch.plan
    if coarse.square[organ] == 0.0 or plan.handled or not may_be_coarse(world) or not is_left_alone(world.state):
        return
    frequency = math.sqrt(coarse.square[organ] * settings.stiffness_scale + added)
    substeps = max(min_substeps_of(settings.tick_time), math.ceil(settings.tick_time * frequency / (2.0 * SAFETY)))
    if substeps < plan.substeps:
        plan.coarse, plan.substeps = True, substeps


@kernel
def may_be_coarse(world: World) -> bool:
    """Return whether the whole organ moves, and nothing requires shorter steps: fault, inverted cells, oscillation."""
    status = world.state.status
    sound = status.region == Region.WHOLE and status.turned == 0 and status.backoff <= 1 and status.oscillating == 0
    symplectic = world.settings.integrator == Integrator.SYMPLECTIC
    return symplectic and sound and not has_compressed_cells(world.model) and shortening_of(world.model) == 1


@kernel
def is_left_alone(state: State) -> bool:
    """Return whether no tool is near, and no node is fast."""
    if state.contacts.header.points > 0:
        return False
    velocity = state.velocity.reshape(state.velocity.size)
    fast = 0
    for index in range(len(velocity)):
        fast += abs(velocity[index]) > CALM_SPEED
    return fast == 0


@kernel
def ratio_of(plan: Plan, substeps: int) -> int:
    """Return the number of the tick's substeps in one substep of an organ; more than 1 only in coarse steps."""
    return substeps // plan.substeps if plan.coarse else 1


@kernel
def fit_coarse(plan: Plan, substeps: int) -> None:
    """Increase the number of an organ's coarse steps until it divides the tick's substeps."""
    while substeps % plan.substeps != 0:
        plan.substeps += 1
