"""Kernels called by themselves, with arguments of the types that they have in a tick."""

from typing import Any

from tissue_sim.handles import handle
from tissue_sim.model.data.world import World, make_world


def by_reference(simulation: Any) -> World:
    """Model, state, shapes, settings and scratch as a tick hands them on, by reference: what kernels change is seen.

    For these types a kernel was compiled with the tick; for the plain tuples it takes up to half a minute more.
    """
    world = make_world(simulation.model, simulation.state, simulation.shapes, simulation.settings, simulation.scratch)
    return World(*(handle(part) if hasattr(part, "_fields") else part for part in world))
