"""An organ and its tools in one thread: poses in, ticks, wrenches out. For tests, benches and scripts."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from tissue_sim.contact.finder import ContactFinder, ContactSet, hand_over
from tissue_sim.contact.tools import Tool, ToolSet
from tissue_sim.model import state as st
from tissue_sim.model.inputs import take_force, take_pose
from tissue_sim.model.simulation import Simulation
from tissue_sim.model.state import Floats
from tissue_sim.organ.organ import Organ


class Scene:
    """A simulation whose contact sets are found anew before each tick.

    organ, model, rate, local_region as in Simulation; tools the rigid tools.
    """

    def __init__(
        self,
        organ: Organ,
        tools: list[Tool],
        model: str = "hybrid",
        rate: float = 1000.0,
        local_region: str = "off",
    ) -> None:
        self.tools = ToolSet(tools)
        self.simulation = Simulation(organ, model, rate, local_region, self.tools.shapes)
        self.finder = ContactFinder(organ.rest_positions, organ.surface_triangles, organ.n_surface, self.tools)
        self.contacts: ContactSet | None = None
        self._sequence = 0

    @property
    def wrenches(self) -> Floats:
        """(T, 6) N and N m about each tool's origin: what the hands should feel; the live array."""
        return self.simulation.state.wrench

    def move(self, tool: int, position: ArrayLike, quaternion: ArrayLike = (0.0, 0.0, 0.0, 1.0)) -> None:
        """A new pose of a tool: position (3,) m and unit quaternion xyzw."""
        pose = np.concatenate([np.asarray(position, dtype=np.float64), np.asarray(quaternion, dtype=np.float64)])
        self._sequence += 1
        take_pose(self.simulation.state, tool, pose, self._sequence)

    def push(self, tool: int, force: ArrayLike) -> None:
        """A new external force (3,) N on the tissue at a tool's tip."""
        self._sequence += 1
        take_force(self.simulation.state, tool, np.asarray(force, dtype=np.float64), self._sequence)

    def step(self) -> None:
        """Find the contacts and advance by one tick."""
        state = self.simulation.state
        fresh = (state.tool_count[:, st.AGE] >= 0).astype(np.int64)
        pushing = (state.tool_count[:, st.FORCE_AGE] >= 0).astype(np.int64)
        found = self.finder.find(self.simulation.positions, state.tool_goal, np.zeros(len(fresh)), fresh, pushing)
        self._sequence += 1
        hand_over(state, found, self._sequence)
        self.contacts = found
        self.simulation.step()
