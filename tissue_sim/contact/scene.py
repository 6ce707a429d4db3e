"""Scene of organs and tools in one thread: poses in, ticks, wrenches out; for tests, benches and scripts."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from tissue_sim.array_types import Floats
from tissue_sim.contact.attachments import Attachment, Breathing
from tissue_sim.contact.finder import ContactFinder
from tissue_sim.contact.gripper import about
from tissue_sim.contact.joining import join
from tissue_sim.contact.pair_finder import PairFinder
from tissue_sim.contact.tools import Tool, ToolSet
from tissue_sim.contact.touched import TouchedOrgan
from tissue_sim.model.contact_set import ContactSet
from tissue_sim.model.simulation import Simulation
from tissue_sim.model.together import Joined
from tissue_sim.organ.organ import Organ


class Scene:
    """Organs whose contact sets are found anew before each tick, or every few ticks as beside the node's loop.

    A tool moves in space and touches all organs; each yields to it independently, and the haptic output is the sum.

    Parameters
    ----------
    organ : Organ | Sequence[Organ]
        One organ, or several, where they lie.
    tools : list[Tool]
        Rigid tools.
    model : str, optional
        As in Simulation, of every organ.
    rate : float, Hz, optional
        As in Simulation.
    local_region : str, optional
        As in Simulation.
    ticks_a_set : int, optional
        Ticks per contact set.
    integrator : str, optional
        As in Simulation.
    stiffness : Sequence[float], shape (k,), optional
        Factors of each organ's stiffness.
    attachments : Sequence[Attachment], optional
        Attachments between organs, or to points.
    breathing : Breathing | None, optional
        Breathing; None for none.

    Raises
    ------
    UserError
        Where organs and attachments don't fit together.
    """

    def __init__(
        self,
        organ: Organ | Sequence[Organ],
        tools: list[Tool],
        model: str = "auto",
        rate: float = 1000.0,
        local_region: str = "off",
        ticks_a_set: int = 1,
        integrator: str = "symplectic",
        stiffness: Sequence[float] = (),
        attachments: Sequence[Attachment] = (),
        breathing: Breathing | None = None,
        breathes: Sequence[float] = (),
        organ_friction: float = 0.0,
        gravity: ArrayLike = (0.0, 0.0, 0.0),
        self_contact: bool = False,
    ) -> None:
        self.tools = ToolSet(tools)
        organs = [organ] if isinstance(organ, Organ) else list(organ)
        self.organs = [
            TouchedOrgan(
                Simulation(
                    one,
                    model=model,
                    rate=rate,
                    local_region=local_region,
                    shapes=self.tools.shapes,
                    integrator=integrator,
                    gravity=gravity,
                ),
                self.tools,
                ticks_a_set,
            )
            for one in organs
        ]
        for one, factor in zip(self.simulations, stiffness, strict=bool(stiffness)):
            one.settings.stiffness_scale = factor
            one.set_substeps()
        self._sequence, self._ticks_a_set, self._ticks = 0, ticks_a_set, 0
        self._origin = np.zeros((len(tools), 3))  # m, where each tool was moved to
        self.joined: Joined | None = None  # what joins organs; of one that nothing joins: nothing
        self._pairs: PairFinder | None = None
        self._found_at = self.offsets  # when they were last looked for
        if len(organs) > 1 or attachments or breathing is not None or self_contact:
            self.joined = join(self.simulations, attachments, breathing, breathes, organ_friction)
            self._own = [self_contact] * len(organs)
            self._pairs = PairFinder(organs)

    @property
    def simulations(self) -> list[Simulation]:
        """Simulation of each organ."""
        return [one.simulation for one in self.organs]

    @property
    def simulation(self) -> Simulation:
        """Simulation of the first organ."""
        return self.organs[0].simulation

    @property
    def finder(self) -> ContactFinder:
        """Contact finder of the first organ."""
        return self.organs[0].finder

    @property
    def contacts(self) -> ContactSet | None:
        """Newest contact set of the first organ."""
        return self.organs[0].contacts

    @property
    def offsets(self) -> Floats:
        """Displacement of each organ by the breath, (k, 3) m, which its positions don't include."""
        return np.array([one.state.carried for one in self.simulations])

    def reset(self) -> None:
        """Return to rest, breathed out, without tools; the settings stay."""
        for one in self.organs:
            one.reset()
        if self.joined is not None:
            self.joined.reset()
        if self._pairs is not None:
            self._pairs.forget()
        self._ticks = 0
        self._origin[:] = 0.0

    def set_gravity(self, gravity: ArrayLike) -> None:
        """Set the gravity of all organs, under which they have their shapes.

        Parameters
        ----------
        gravity : ArrayLike, shape (3,), m/s^2
            The gravity.
        """
        for one in self.simulations:
            one.set_gravity(gravity)
        if self.joined is not None:
            self.joined.note_gravity()

    def set_substeps(self) -> None:
        """Compute the substeps of each tick, after stiffness, damping or the rate changed."""
        if self.joined is None:
            self.simulation.set_substeps()
        else:
            self.joined.set_substeps()

    @property
    def wrenches(self) -> Floats:
        """Haptic output of each tool about its origin, (T, 6) N and N m.

        The live array of an organ alone, unless a tool has more than one body.
        """
        felt, poses = self.simulation.state.wrench, self.simulation.state.body_pose[:, :3]
        if self.joined is not None:
            felt = self.joined.wrench
        if len(felt) == len(self.tools.tools):
            return felt
        origins = self._origin - self.offsets[0]
        return np.array([about(at, felt[own], poses[own]) for at, own in zip(origins, self.tools.bodies, strict=True)])

    def move(
        self,
        tool: int,
        position: ArrayLike,
        quaternion: ArrayLike = (0.0, 0.0, 0.0, 1.0),
        angle: float = 0.0,
        stamp: int = 0,
    ) -> None:
        """Set a new pose of a tool.

        Parameters
        ----------
        tool : int
            Index of the tool.
        position : ArrayLike, shape (3,), m
            Its origin.
        quaternion : ArrayLike, shape (4,), xyzw, optional
            Unit quaternion.
        angle : float, rad, optional
            Angle between a gripper's jaws.
        stamp : int, ns, optional
            Time of the pose; 0 for unknown, so that it counts from its arrival.
        """
        pose = np.concatenate([np.asarray(position, dtype=np.float64), np.asarray(quaternion, dtype=np.float64)])
        self._origin[tool] = pose[:3]
        self._sequence += 1
        for body, at in zip(self.tools.bodies[tool], self.tools.poses(tool, pose, angle), strict=True):
            for simulation, offset in zip(self.simulations, self.offsets, strict=True):
                carried = at.copy()
                carried[:3] -= offset
                simulation.take_pose(body, carried, self._sequence, stamp)

    def push(self, tool: int, force: ArrayLike) -> None:
        """Set a new external force on the tissue at a tool's tip.

        Parameters
        ----------
        tool : int
            Index of the tool.
        force : ArrayLike, shape (3,), N
            The force.
        """
        self._sequence += 1
        body = self.tools.bodies[tool][0]
        for simulation in self.simulations:
            simulation.take_force(body, np.asarray(force, dtype=np.float64), self._sequence)

    def step(self) -> None:
        """Find the contacts when they are due, and advance by one tick."""
        if self._ticks % self._ticks_a_set == 0:
            self.find()
        self._ticks += 1
        if self.joined is None:
            self.simulation.step()
        else:
            self.joined.step()

    def find(self) -> None:
        """Find what tools and organs may touch at present, and apply it."""
        self._sequence += 1
        for one in self.organs:
            one.find(self._sequence)
        self._find_pairs()

    def _find_pairs(self) -> None:
        """Find where organs touch each other, unless all of them sleep and the breath has not moved them since."""
        offsets = self.offsets
        is_still = np.array_equal(offsets, self._found_at) and all(one.asleep for one in self.simulations)
        if self._pairs is None or self.joined is None or is_still:
            return
        self._found_at = offsets
        there = [one.positions + offset for one, offset in zip(self.simulations, offsets, strict=True)]
        own = [one and not simulation.asleep for one, simulation in zip(self._own, self.simulations, strict=True)]
        self.joined.take_pairs(self._pairs.find(there, own))
