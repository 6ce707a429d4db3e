"""Settling of an organ: steps until it is in equilibrium."""

from __future__ import annotations

import math
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from tissue_sim.array_types import Floats
from tissue_sim.model.contact.lips import add_lip_impulses
from tissue_sim.model.contact.volume_limit import add_volume_limit_impulses
from tissue_sim.model.data.model import Model
from tissue_sim.model.data.scratch import Scratch
from tissue_sim.model.data.settings import Settings
from tissue_sim.model.data.state import Region, State
from tissue_sim.model.data.world import World
from tissue_sim.model.elasticity.forces import elastic_forces
from tissue_sim.model.stepping.world import (
    add_weight_of_world,
    is_world_out_of_balance,
    load_world,
    prescribe_world,
    relax_world,
    return_rate_of_world,
)

MIN_RETURN_TIME = 0.1  # s, least time in which an organ may complete the rest of its return


class Steppable(Protocol):
    """Interface of a simulation that can settle."""

    model: Model
    state: State
    settings: Settings
    scratch: Scratch
    world: World
    rate: float

    @property
    def positions(self) -> Floats:
        """Positions of all nodes, (n, 3) m."""

    def step(self) -> None:
        """Advance by 1/rate seconds."""

    def reset(self) -> None:
        """Return to the rest shape."""


def settle(simulation: Steppable, forces: Floats, tolerance: float, longest: float, ramp: float) -> tuple[Floats, bool]:
    """Return the displacements at equilibrium under constant surface forces, gravity, and prescribed nodes.

    It steps from the rest shape until the residual force is below `tolerance` times the load, or times the force that
    holds prescribed nodes, and the organ is nearly still compared with its return rate. Forces act, and prescribed
    nodes move, at once, or within `ramp` seconds, so that the organ doesn't overshoot.

    Parameters
    ----------
    simulation : Simulation
        The simulation.
    forces : Floats, shape (n_surface, 3), N
        Forces on the surface nodes.
    tolerance : float
        Residual force over load.
    longest : float, s
        Simulated time after which settling is abandoned.
    ramp : float, s
        Time in which forces rise and prescribed nodes move.

    Returns
    -------
    tuple[Floats, bool]
        Displacements, shape (n_surface, 3), m, and whether it settled.
    """
    n_surface = simulation.model.n_surface
    state = simulation.state
    led = state.prescribed_node[: state.status.prescribed].copy()
    goal = state.prescribed_to[led]
    simulation.reset()
    loaded = np.flatnonzero(np.any(forces != 0.0, axis=1))
    heavy = is_world_out_of_balance(simulation.world)
    if not len(loaded) and not len(led) and not heavy:
        return np.zeros((n_surface, 3)), True
    load = forces.astype(np.float64)
    if heavy:
        pull = np.zeros_like(state.position)
        add_weight_of_world(simulation.world, pull)
        load = load + pull[:n_surface]
    size = float(np.linalg.norm(load))
    pushes = np.ascontiguousarray(forces[loaded], dtype=np.float64)
    settled = False
    coming = max(MIN_RETURN_TIME, 2.0 / return_rate_of_world(simulation.world))
    faults = state.count.faults
    raised = max(1, math.ceil(ramp * simulation.rate))
    prescribe_world(simulation.world, led, goal, raised)
    for first in range(1, math.ceil(longest * simulation.rate) + 1, 20):
        for tick in range(first, first + 20):
            load_world(simulation.world, loaded, min(1.0, tick / raised) * pushes)
            simulation.step()
        if len(state.relaxing):
            relax_world(simulation.world)  # the equilibrium is that of held tissue
        if first + 19 < raised:
            continue
        if state.count.faults > faults and not np.any(state.velocity):
            continue
        left = residuals(simulation, forces)
        residual = float(np.linalg.norm(left[_free_nodes(simulation)]))
        size = max(size, float(np.linalg.norm(left[led])))
        speed = float(np.abs(state.velocity).max())
        reach = float(np.abs(state.position - simulation.model.rest).max())
        if residual <= tolerance * size and speed * coming <= tolerance * max(reach, 1e-9):
            settled = not _modes_move(simulation, tolerance)
            if settled:
                break
    return simulation.positions[:n_surface] - simulation.model.rest[:n_surface], settled


def residuals(simulation: Steppable, forces: Floats | float = 0.0) -> Floats:
    """Return the residual force on every node under surface forces; impulses of volume limit and lips count as forces.

    Parameters
    ----------
    simulation : Simulation
        The simulation.
    forces : Floats | float, shape (n_surface, 3), N, optional
        Forces on the surface nodes.

    Returns
    -------
    Floats, shape (n, 3), N
        Residual forces.
    """
    force = np.zeros_like(simulation.model.rest)
    elastic_forces(simulation.model, simulation.state.position, float(simulation.settings.stiffness_scale), force)
    add_weight_of_world(simulation.world, force)
    force[: simulation.model.n_surface] += forces
    step = float(simulation.settings.tick_time) / max(1, simulation.state.status.substeps)
    add_volume_limit_impulses(simulation.scratch, step, force)
    add_lip_impulses(simulation.model.lips, step, force)
    return force


def _modes_move(simulation: Steppable, tolerance: float) -> bool:
    """Return whether the modes of a modal region are still moving."""
    if simulation.state.status.region != Region.MODAL:
        return False
    speed, reach = (np.linalg.norm(a) for a in (simulation.state.mode_velocity, simulation.state.mode_position))
    return bool(speed * 0.1 > tolerance * reach)


def _free_nodes(simulation: Steppable) -> NDArray[np.int64]:
    """Return the nodes (k,) that aren't prescribed."""
    nodes: Any = simulation.model.moving
    if simulation.state.status.region != Region.WHOLE:
        nodes = simulation.scratch.moved_node[: simulation.scratch.n_moved[0]]
    return np.asarray(nodes[simulation.state.is_prescribed[nodes] == 0], dtype=np.int64)
