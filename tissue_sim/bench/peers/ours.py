"""Models of this package as compared engines."""

from __future__ import annotations

from typing import Unpack

import numpy as np

from tissue_sim.array_types import Floats
from tissue_sim.bench.peers.engine import TOLERANCE, Answer, Load, timed
from tissue_sim.bench.simulation_options import SimulationOptions
from tissue_sim.bench.timing import Burst, Ticks
from tissue_sim.model.data.settings import LocalRegion
from tissue_sim.model.simulation import Simulation
from tissue_sim.organ.organ import Organ


class Ours:
    """Simulation with options; a local region is kept whatever the load, so that it is assessed alone.

    longest: simulated time after which it counts as not settled, s; substeps: number in a tick, instead of the one from
    the critical step; options: further options of Simulation. Raises UserError as Simulation does.
    """

    def __init__(
        self,
        organ: Organ,
        longest: float = 5.0,
        substeps: int | None = None,
        **options: Unpack[SimulationOptions],
    ) -> None:
        self.organ = organ
        self.longest = longest
        self.simulation = Simulation(organ, substeps=substeps, **options)
        self.simulation.settings.region_force = np.inf
        self.update = 1.0 / self.simulation.rate
        self.simulation.step()  # compiles, before anything is timed

    @property
    def substeps(self) -> int:
        """Number of substeps of a tick; those of the local region where there is one."""
        settings = self.simulation.settings
        local = settings.local_region != LocalRegion.OFF
        return int(settings.region_substeps if local else settings.substeps)

    def settle(self, load: Load) -> Answer:
        """Return the equilibrium of the model."""
        found: list[tuple[Floats, bool]] = []
        seconds = timed(lambda: found.append(self.simulation.settle(load.force, TOLERANCE, self.longest)))
        return Answer(found[0][0], seconds, found[0][1])

    def burst(self, load: Load) -> Burst:
        """Return ticks under the load, which rises and falls, after the first impact."""
        ticks = Ticks(self.simulation, load.nodes, load.force[load.nodes])
        ticks.swing()
        return ticks
