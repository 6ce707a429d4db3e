"""Organs and tools in one thread: poses in, ticks, wrenches out. For tests, benches and scripts."""

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

    organ: one, or several, where they lie; tools the rigid tools; model, rate, local_region, integrator as in
    Simulation, of every organ; ticks_a_set: ticks for each contact set; stiffness (k,) factors on that of each organ's
    tissue. attachments between organs, or to points; breathing, and how far each organ's clamp goes with it,
    `breathes` (k,). Several organs touch each other, with the Coulomb coefficient `organ_friction`. gravity (3,) m/s^2,
    under which they have their shapes. self_contact: whether an organ's own folds touch.

    A tool moves in the room, and touches all organs; each gives way to it by itself, and what a hand feels is the sum.
    Raises UserError where organs and attachments don't fit together.
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
        if len(organs) > 1 or attachments or breathing is not None or self_contact:
            self.joined = join(self.simulations, attachments, breathing, breathes, organ_friction)
        else:
            self.joined = Joined(self.simulations)
        self._pairs = None if self.joined.alone else PairFinder(organs)
        self._own = [self_contact] * len(organs)
        self._found_at = self.offsets  # when pairs were last looked for

    @property
    def simulations(self) -> list[Simulation]:
        """Of each organ."""
        return [one.simulation for one in self.organs]

    @property
    def simulation(self) -> Simulation:
        """Of the first organ."""
        return self.organs[0].simulation

    @property
    def finder(self) -> ContactFinder:
        """Of the first organ."""
        return self.organs[0].finder

    @property
    def contacts(self) -> ContactSet | None:
        """The first organ's newest contact set."""
        return self.organs[0].contacts

    @property
    def offsets(self) -> Floats:
        """(k, 3) m by which the breath has carried each organ; its positions are those without it."""
        return np.array([one.state.carried for one in self.simulations])

    def reset(self) -> None:
        """Back to rest, breathed out, without tools; the settings stay."""
        for one in self.organs:
            one.reset()
        self.joined.reset()
        if self._pairs is not None:
            self._pairs.forget()
        self._ticks = 0
        self._origin[:] = 0.0

    def set_gravity(self, gravity: ArrayLike) -> None:
        """Gravity (3,) m/s^2 of all organs, under which they have their shapes."""
        for one in self.simulations:
            one.set_gravity(gravity)
        self.joined.note_gravity()

    def set_substeps(self) -> None:
        """Work out the substeps of each tick, after stiffness, damping or the rate changed."""
        self.joined.set_substeps()

    @property
    def wrenches(self) -> Floats:
        """(T, 6) N and N m about each tool's origin: what the hands should feel.

        The live array of an organ alone, unless a tool has more than one body.
        """
        felt, poses = self.joined.wrench, self.simulation.state.body_pose[:, :3]
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
        """A new pose of a tool: position (3,) m and unit quaternion xyzw; angle rad between a gripper's jaws.

        stamp: ns, when the tool was there; 0: it came as fast as it moved.
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
        """A new external force (3,) N on the tissue at a tool's tip."""
        self._sequence += 1
        body = self.tools.bodies[tool][0]
        for simulation in self.simulations:
            simulation.take_force(body, np.asarray(force, dtype=np.float64), self._sequence)

    def step(self) -> None:
        """Find the contacts when it is time, and advance by one tick."""
        if self._ticks % self._ticks_a_set == 0:
            self.find()
        self._ticks += 1
        self.joined.step()

    def find(self) -> None:
        """Find what tools and organs may touch where they are now, and take it up."""
        self._sequence += 1
        for one in self.organs:
            one.find(self._sequence)
        self._find_pairs()

    def _find_pairs(self) -> None:
        """Where organs touch each other, unless all of them sleep and the breath has not moved them since."""
        if self._pairs is None:
            return
        offsets = self.offsets
        is_still = np.array_equal(offsets, self._found_at) and all(one.asleep for one in self.simulations)
        if is_still:
            return
        self._found_at = offsets
        there = [one.positions + offset for one, offset in zip(self.simulations, offsets, strict=True)]
        own = [one and not simulation.asleep for one, simulation in zip(self._own, self.simulations, strict=True)]
        self.joined.take_pairs(self._pairs.find(there, own))
