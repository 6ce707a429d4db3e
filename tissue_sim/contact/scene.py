"""An organ and its tools in one thread: poses in, ticks, wrenches out. For tests, benches and scripts."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from tissue_sim.array_types import Floats
from tissue_sim.contact.finder import ContactFinder, reach_margins
from tissue_sim.contact.gripper import about
from tissue_sim.contact.tools import Tool, ToolSet
from tissue_sim.model.contact_set import ContactSet
from tissue_sim.model.simulation import Simulation
from tissue_sim.organ.organ import Organ


class Scene:
    """A simulation whose contact sets are found anew before each tick, or every few ticks as beside the node's loop.

    organ, model, rate, local_region, integrator as in Simulation; tools the rigid tools; ticks_a_set: ticks for each
    contact set.
    """

    def __init__(
        self,
        organ: Organ,
        tools: list[Tool],
        model: str = "auto",
        rate: float = 1000.0,
        local_region: str = "off",
        ticks_a_set: int = 1,
        integrator: str = "symplectic",
    ) -> None:
        self.tools = ToolSet(tools)
        self.simulation = Simulation(
            organ,
            model=model,
            rate=rate,
            local_region=local_region,
            shapes=self.tools.shapes,
            integrator=integrator,
        )
        self.finder = ContactFinder(organ.rest_positions, organ.surface_triangles, organ.n_surface, self.tools)
        self.contacts: ContactSet | None = None
        self._sequence, self._ticks_a_set, self._ticks = 0, ticks_a_set, 0
        self._set_goal: Floats | None = None  # the bodies' poses at the last contact set
        self._origin = np.zeros((len(tools), 3))  # m, where each tool was moved to

    def reset(self) -> None:
        """Back to rest, without tools; the settings stay."""
        self.simulation.reset()
        self.contacts, self._set_goal, self._ticks = None, None, 0
        self._origin[:] = 0.0

    @property
    def wrenches(self) -> Floats:
        """(T, 6) N and N m about each tool's origin: what the hands should feel.

        The live array, unless a tool has more than one body.
        """
        wrench, poses = self.simulation.state.wrench, self.simulation.state.body_pose[:, :3]
        if len(wrench) == len(self.tools.tools):
            return wrench
        bodies = self.tools.bodies
        return np.array([about(self._origin[tool], wrench[own], poses[own]) for tool, own in enumerate(bodies)])

    def move(
        self,
        tool: int,
        position: ArrayLike,
        quaternion: ArrayLike = (0.0, 0.0, 0.0, 1.0),
        angle: float = 0.0,
        stamp: int = 0,
    ) -> None:
        """A new pose of a tool: position (3,) m and unit quaternion xyzw; angle rad between a gripper's jaws.

        stamp: ns, when the tool was there; 0: it came as fast as it moved.
        """
        pose = np.concatenate([np.asarray(position, dtype=np.float64), np.asarray(quaternion, dtype=np.float64)])
        self._origin[tool] = pose[:3]
        self._sequence += 1
        for body, at in zip(self.tools.bodies[tool], self.tools.poses(tool, pose, angle), strict=True):
            self.simulation.take_pose(body, at, self._sequence, stamp)

    def push(self, tool: int, force: ArrayLike) -> None:
        """A new external force (3,) N on the tissue at a tool's tip."""
        self._sequence += 1
        body = self.tools.bodies[tool][0]
        self.simulation.take_force(body, np.asarray(force, dtype=np.float64), self._sequence)

    def step(self) -> None:
        """Find the contacts when it is time, and advance by one tick."""
        if self._ticks % self._ticks_a_set == 0:
            self._find()
        self._ticks += 1
        self.simulation.step()

    def _find(self) -> None:
        state = self.simulation.state
        fresh = ((state.bodies.age >= 0) & ~state.bodies.lapsed.astype(bool)).astype(np.int64)
        pushing = (state.bodies.force_age >= 0).astype(np.int64)
        goal = state.body_goal.copy()
        margins = np.zeros(len(fresh))
        if self._ticks_a_set > 1 and self._set_goal is not None:
            behind = state.bodies.speed * state.bodies.remaining
            margins = reach_margins(goal[:, :3], self._set_goal[:, :3], 2.0, behind)
        self._set_goal = goal
        found = self.finder.find(self.simulation.positions, goal, margins, fresh, pushing)
        self._sequence += 1
        self.simulation.take_contacts(found, self._sequence)
        self.contacts = found
