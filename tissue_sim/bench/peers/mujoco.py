"""MuJoCo's flex: linear tetrahedra, corotated, stepped implicitly."""

from __future__ import annotations

import numpy as np

from tissue_sim.array_types import Floats
from tissue_sim.bench.flex import Flex
from tissue_sim.bench.peers.engine import Answer, Load, settle_by_steps
from tissue_sim.bench.peers.tetrahedra import Tetrahedra
from tissue_sim.bench.timing import Burst
from tissue_sim.organ.organ import Organ

DAMPING = 0.1  # s, proportional to stiffness: it changes how an organ settles, not where


class Mujoco:
    """Organ of tetrahedra as a MuJoCo flex.

    step: time step, s; longest: simulated time after which it counts as not settled, s. Raises ModuleNotFoundError
    without mujoco; UserError where MuJoCo can't load the organ.
    """

    def __init__(self, organ: Organ, mesh: Tetrahedra, step: float, longest: float = 2.0) -> None:
        self.organ, self.update, self.longest = organ, step, longest
        none = np.zeros(0, dtype=np.int64), np.zeros((0, 3))
        self._flex = Flex(organ, *none, filling=mesh, step=step, damping=DAMPING)

    def settle(self, load: Load) -> Answer:
        """Step until the surface is at rest."""
        self._load(load)
        return settle_by_steps(self._flex.step, self._surface, self.update, self.longest)

    def burst(self, load: Load) -> Burst:
        """Return a function that times steps under the load."""
        self._load(load)
        return self._flex

    def _load(self, load: Load) -> None:
        self._flex.load(load.nodes, load.force[load.nodes])

    def _surface(self) -> Floats:
        """Return the present displacements (n_surface, 3) m."""
        n = self.organ.n_surface
        return self._flex.positions[:n] - self._flex.rest[:n]
