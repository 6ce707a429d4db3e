"""Options of a simulation in which the rows of a benchmark differ."""

from __future__ import annotations

from typing import TypedDict


class SimulationOptions(TypedDict, total=False):
    """Parameters of `Simulation`, by name."""

    model: str
    integrator: str
    local_region: str
