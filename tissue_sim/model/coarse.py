"""Coarse steps: an organ that no hand is near takes half as many substeps, with masses that allow it.

What loads such an organ are ligaments, its neighbours and the breath, which change slowly against its lowest modes: its
shape follows them nearly as statics have it, whatever its masses. So each node gets as much more mass as a step of
twice the length asks for (selective mass scaling, Olovsson et al. 2005, by Gershgorin's circles). Stiffness, weight
and nodal damping stay: statics and the lag behind a load are the same, only the inertial part of the motion grows.
An organ that a hand touches, or a tool is near, or that is not calm, takes all of its substeps.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from tissue_sim.array_types import Floats, Longs
from tissue_sim.jit import kernel
from tissue_sim.model.critical_step import SAFETY, largest_frequency
from tissue_sim.model.modes import free_axes, stiffness_matrix
from tissue_sim.model.settings import Integrator
from tissue_sim.model.simulation import LONGEST_OF_CELLS, Simulation
from tissue_sim.model.squeezed import has_stiff_cells
from tissue_sim.model.state import Region
from tissue_sim.model.unfelt import rounded_up

CALM_SPEED = 5e-3  # m/s, of any coordinate: a faster motion is not that of a load that changes slowly
ROOM = 1.01  # times the step that is asked for, so that it is stable whatever rounding does
MOST_OF_LINKS = 0.5  # of the squared frequency that a step allows, that links may ask for, or there are no coarse steps
ROUNDING = 1e-9  # of a step
SHARES = np.linspace(0.1, 1.0, 19)  # of what Gershgorin's circles ask for, of which the least that does is taken


class Coarse(NamedTuple):
    """How k organs take coarse steps; their masses then lie in Scratch.coarse."""

    square: Floats  # (k,) (rad/s)^2, of the largest frequency with those masses; 0: never
    ticks: Longs  # (k,) that each has made in coarse steps


def no_coarse(count: int) -> Coarse:
    """So many organs that take all of their substeps."""
    return Coarse(np.zeros(count), np.zeros(count, dtype=np.int64))


def allow_coarse(coarse: Coarse, organ: int, simulation: Simulation, added: float) -> None:
    """Let an organ of cells take half of its present substeps; nothing where that is no fewer, or none symplectic.

    added: (rad/s)^2, what links add to the square of its largest frequency at most.
    """
    settings = simulation.settings
    tick_time, substeps = float(settings.tick_time), int(settings.substeps)
    fewer = max(math.ceil(substeps / 2), least_of(tick_time))
    if fewer >= substeps or simulation.variant != "cells" or settings.integrator != Integrator.SYMPLECTIC:
        return
    allowed = (2.0 * SAFETY * fewer / tick_time) ** 2
    if added > MOST_OF_LINKS * allowed:
        return
    step = 2.0 * ROOM * math.sqrt(settings.stiffness_scale / (allowed - added))
    factor, frequency = masses_for(simulation, step)
    simulation.scratch.coarse[:] = factor
    coarse.square[organ] = frequency**2


def masses_for(simulation: Simulation, step: float) -> tuple[Floats, float]:
    """Factors (n,) on the nodes' masses with which a step of s is stable, and the largest frequency then, rad/s.

    Rounded up to two digits, so that libraries that round differently on another processor come to the same ones, and
    replays to the same bits.
    """
    model = simulation.model
    free = free_axes(model)
    circles = np.asarray(abs(stiffness_matrix(model)[free][:, free]).sum(axis=1)).reshape(-1, 3).max(axis=1)
    needed = 0.25 * step**2 * circles * model.inverse_mass[model.moving]
    factor, found = np.ones(len(model.rest)), math.inf
    for share in SHARES:
        factor[model.moving] = [rounded_up(max(1.0, value)) for value in share * needed]
        found = largest_frequency(model._replace(inverse_mass=model.inverse_mass / factor))
        if found * step <= 2.0:
            break
    return factor, found


@kernel
def least_of(tick_time: float) -> int:
    """Substeps in a tick of s that are no longer than cells may take."""
    return max(1, math.ceil((1.0 - ROUNDING) * tick_time / LONGEST_OF_CELLS))


@kernel
def plan_coarse(world: Any, coarse: Any, organ: int, added: float) -> None:
    """Plan coarse steps for an organ that may take them in this tick; added: by links, (rad/s)^2 at most."""
    settings, plan = world.settings, world.scratch.plan
    if coarse.square[organ] == 0.0 or plan.handled or not may_be_coarse(world) or not is_left_alone(world.state):
        return
    frequency = math.sqrt(coarse.square[organ] * settings.stiffness_scale + added)
    substeps = max(least_of(settings.tick_time), math.ceil(settings.tick_time * frequency / (2.0 * SAFETY)))
    if substeps < plan.substeps:
        plan.coarse, plan.substeps = True, substeps


@kernel
def may_be_coarse(world: Any) -> bool:
    """True where the whole organ moves, and nothing asks for shorter steps."""
    status = world.state.status
    if status.region != Region.WHOLE or status.backoff > 1 or status.turned > 0 or status.shivering > 0:
        return False
    return world.settings.integrator == Integrator.SYMPLECTIC and not has_stiff_cells(world.model)


@kernel
def is_left_alone(state: Any) -> bool:
    """True where no tool is near, and no node is fast."""
    if state.contacts.header.points > 0:
        return False
    velocity = state.velocity.reshape(state.velocity.size)
    fast = 0
    for index in range(len(velocity)):
        fast += abs(velocity[index]) > CALM_SPEED
    return fast == 0


@kernel
def ratio_of(plan: Any, substeps: int) -> int:
    """Substeps of the others in one of an organ in coarse steps, where the tick has so many."""
    return substeps // plan.substeps if plan.coarse else 1


@kernel
def fit_coarse(plan: Any, substeps: int) -> None:
    """Let an organ's coarse steps end with substeps of the tick, which has so many."""
    while substeps % plan.substeps != 0:
        plan.substeps += 1
