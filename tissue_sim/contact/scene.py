"""Scene of organs and tools in one thread: poses in, ticks, wrenches out; for tests, benchmarks and scripts."""

from __future__ import annotations

import warnings
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from tissue_sim.arguments import finite, number_of
from tissue_sim.array_types import Floats
from tissue_sim.contact.attachments import Attachment, Breathing
from tissue_sim.contact.contact_organ import ContactOrgan
from tissue_sim.contact.coupling_setup import join
from tissue_sim.contact.finder import ContactFinder
from tissue_sim.contact.gripper import about
from tissue_sim.contact.organ_contact_finder import OrganContactFinder
from tissue_sim.contact.scene_views import SceneViews
from tissue_sim.contact.tools import Tool, ToolSet
from tissue_sim.errors import UserError
from tissue_sim.model.cutting.cut import CutReport
from tissue_sim.model.data.contact_set import ContactSet
from tissue_sim.model.joined import Joined
from tissue_sim.model.simulation import Simulation
from tissue_sim.organ.organ import Organ

TICKS_A_CUT = 10  # after which the scene checks whether blades have cut


class Scene(SceneViews):
    """Organs whose contact sets are found before each tick, or every few ticks as in the node.

    A tool moves in space and can touch all organs; each yields independently, and the haptic output is the sum.

    Parameters
    ----------
    organ : Organ | Sequence[Organ]
        One organ, or several, in their places.
    tools : list[Tool]
        Rigid tools.
    model : str, optional
        As in Simulation, of every organ.
    rate : float, Hz, optional
        As in Simulation.
    local_region : str, optional
        As in Simulation.
    ticks_a_set : int, optional
        Number of ticks for which a contact set is used.
    integrator : str, optional
        As in Simulation.
    stiffness : Sequence[float], shape (k,), optional
        Factors on each organ's stiffness.
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
        if not organs:
            raise UserError("a scene needs at least one organ")
        self.names = [one.name for one in organs]
        self.organs = [
            ContactOrgan(
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
        for one, factor in zip(self.simulations, _factors(stiffness, len(organs)), strict=True):
            if factor != 1.0:
                one.settings.stiffness_scale = factor
                one.set_substeps()
        self.sequence, self.ticks_a_set, self.ticks = 0, ticks_a_set, 0
        self.origins = np.zeros((len(tools), 3))  # m, place to which each tool was moved
        # Whether each tool has one body with the same origin: the origin of an instrument's part is elsewhere.
        self._has_own_origins = all(one.n_bodies == 1 and one.shape != "urdf" for one in tools)
        if len(organs) > 1 or attachments or breathing is not None or self_contact:
            self.joined = join(self.simulations, attachments, breathing, breathes, organ_friction)
        else:
            self.joined = Joined(self.simulations)
        may_meet = len(organs) > 1 or self_contact
        self.pairs_finder = OrganContactFinder(organs) if may_meet else None
        self._own = [self_contact] * len(organs)
        self.found_at = self.offsets  # when pairs were last searched

    def __repr__(self) -> str:
        tools = ", ".join(f"{tool.name} ({tool.shape})" for tool in self.tools.tools) or "no tools"
        first = self.simulation
        return f"<Scene of {', '.join(self.names)}; {tools}; {first.rate:g} Hz, {self.time:.3f} s>"

    @property
    def time(self) -> float:
        """Return the simulated time, s."""
        return self.simulation.time

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
        """Return to rest, exhaled, uncut, without tools; the settings don't change."""
        for number, one in enumerate(self.organs):
            if one.heal():
                self._take_up(number)
            one.reset()
        self.joined.reset()
        if self.pairs_finder is not None:
            self.pairs_finder.forget()
        self.ticks = 0
        self.origins[:] = 0.0

    def cut(self, organ: int | str, polyline: ArrayLike, direction: ArrayLike, depth: float) -> CutReport:
        """Cut an organ, whose lips and walls tools can then touch; `reset` heals it.

        The cut is given in the organ's rest coordinates; see Simulation.cut.

        Parameters
        ----------
        organ : int | str
            Name (see `names`) or number of the organ.
        polyline : ArrayLike, shape (m, 3), m
            The blade's edge where it touches the surface, or above it: two points or more.
        direction : ArrayLike, shape (3,)
            Direction in which it is moved; of any length.
        depth : float, m
            Distance by which it is moved.

        Raises
        ------
        UserError
            For an organ that the scene doesn't have, and for cuts that `Simulation.cut` refuses.
        """
        number = number_of(organ, self.names, "organ")
        one = self.organs[number]
        one.exchange(one.simulation.cut(polyline, direction, depth))
        self._take_up(number)
        self.find()
        return one.simulation.cuts[-1]

    def _take_up(self, number: int) -> None:
        """Couple an organ whose simulation was replaced."""
        one = self.organs[number]
        plan = self.joined.plan_exchange(number, one.simulation)
        self.joined.exchange(number, one.simulation, plan)
        self.joined.set_substeps()
        if self.pairs_finder is not None:
            self.pairs_finder.exchange(number, one.finder.surface, plan.version)

    def set_gravity(self, gravity: ArrayLike) -> None:
        """Set the gravity of all organs, under which they have their shapes.

        Parameters
        ----------
        gravity : ArrayLike, shape (3,), m/s^2
            The gravity.
        """
        for one in self.simulations:
            one.set_gravity(gravity)
        self.joined.note_gravity()

    def set_substeps(self) -> None:
        """Compute the substeps of each tick, after stiffness, damping or the rate changed."""
        self.joined.set_substeps()

    @property
    def wrenches(self) -> Floats:
        """Haptic output of each tool about its origin, (T, 6) N and N m.

        For a single organ it is the live array, unless a tool has more than one body, or a URDF.
        """
        felt, poses = self.joined.wrench, self.simulation.state.body_pose[:, :3]
        if self._has_own_origins:
            return felt
        origins = self.origins - self.offsets[0]
        return np.array([about(at, felt[own], poses[own]) for at, own in zip(origins, self.tools.bodies, strict=True)])

    def wrench(self, tool: int | str) -> Floats:
        """Return the haptic output of a tool.

        Parameters
        ----------
        tool
            Its name or number.

        Returns
        -------
        Floats
            (6,) N and N m about the tool's origin, in the scene's axes; a copy.

        Raises
        ------
        UserError
            For a tool that the scene doesn't have.
        """
        return self.wrenches[self.tools.index(tool)].copy()

    def surface_positions(self, organ: int | str = 0) -> Floats:
        """Return the positions of an organ's surface nodes, with the displacement by the breath.

        Parameters
        ----------
        organ
            Its name (see `names`) or number.

        Returns
        -------
        Floats
            (n_surface, 3) m.

        Raises
        ------
        UserError
            For an organ that the scene doesn't have.
        """
        simulation = self.simulations[number_of(organ, self.names, "organ")]
        return np.asarray(simulation.surface_positions + simulation.state.carried)

    def surface_normals(self, organ: int | str = 0) -> Floats:
        """Return the outward unit normals at the surface nodes of an organ, (n_surface, 3).

        Raises
        ------
        UserError
            For an organ that the scene doesn't have.
        """
        return self.simulations[number_of(organ, self.names, "organ")].surface_normals

    def move(
        self,
        tool: int | str,
        position: ArrayLike,
        quaternion: ArrayLike = (0.0, 0.0, 0.0, 1.0),
        angle: float = 0.0,
        stamp: int = 0,
    ) -> None:
        """Set a new pose of a tool, which takes effect in the next tick.

        Parameters
        ----------
        tool
            Its name or number.
        position
            (3,) m, of its origin.
        quaternion
            (4,) xyzw, of length 1.
        angle
            rad, between a gripper's jaws.
        stamp
            ns, time at which the tool was there; 0: the time of arrival.

        Raises
        ------
        UserError
            For a tool that the scene doesn't have, and for numbers that are not a pose.
        """
        number = self.tools.index(tool)
        name = f"of tool '{self.tools.tools[number].name}'"
        turn = finite(quaternion, 4, f"the quaternion {name}")
        if abs(np.sqrt(np.sum(turn**2)) - 1.0) > 1e-6:
            raise UserError(f"the quaternion {name}, {turn.tolist()}, is not of length 1")
        pose = np.concatenate([finite(position, 3, f"the position {name}"), turn])
        finite([angle], 1, f"the angle {name}")
        self.origins[number] = pose[:3]
        self.sequence += 1
        for body, at in zip(self.tools.bodies[number], self.tools.poses(number, pose, angle), strict=True):
            for simulation, offset in zip(self.simulations, self.offsets, strict=True):
                carried = at.copy()
                carried[:3] -= offset
                simulation.take_pose(body, carried, self.sequence, stamp)

    def push(self, tool: int | str, force: ArrayLike) -> None:
        """Set the external force (3,) N on the tissue at a tool's tip.

        Raises
        ------
        UserError
            For a tool that the scene doesn't have, and for a force that is not finite.
        """
        number = self.tools.index(tool)
        given = finite(force, 3, f"the force of tool '{self.tools.tools[number].name}'")
        self.sequence += 1
        body = self.tools.bodies[number][0]
        for simulation in self.simulations:
            simulation.take_force(body, given, self.sequence)

    def step(self, ticks: int = 1) -> None:
        """Advance by some ticks of 1/rate seconds; contacts are found every `ticks_a_set` ticks."""
        for _ in range(ticks):
            if self.ticks % self.ticks_a_set == 0:
                self.find()
            self.ticks += 1
            self.joined.step()
            if self.ticks % TICKS_A_CUT == 0:
                self.open_cuts()

    def open_cuts(self) -> None:
        """Open the cuts that blades have made since the last call; `step` calls this every few ticks."""
        for number, one in enumerate(self.organs):
            if not one.blade_cuts:
                continue
            one.blade_cuts.note(one.simulation)
            for sheet in one.blade_cuts.due():
                try:
                    made = one.simulation.prepared_sheet(sheet)
                except UserError as error:
                    then = one.blade_cuts.refuse(sheet)
                    warnings.warn(
                        f"a blade's cut of organ '{self.names[number]}' was not opened: {error}; {then}", stacklevel=3
                    )
                    continue
                one.blade_cuts.opened(sheet)
                made.continue_from(one.simulation)
                one.exchange(made)
                self._take_up(number)

    def find(self) -> None:
        """Find contacts of tools and organs at present, and apply them."""
        self.sequence += 1
        for one in self.organs:
            one.find(self.sequence)
        self._find_pairs()

    def _find_pairs(self) -> None:
        """Find contacts between organs, unless all sleep and the breath has not moved them since the last search."""
        if self.pairs_finder is None:
            return
        offsets = self.offsets
        is_still = np.array_equal(offsets, self.found_at) and all(one.asleep for one in self.simulations)
        if is_still:
            return
        self.found_at = offsets
        there = [one.positions + offset for one, offset in zip(self.simulations, offsets, strict=True)]
        own = [one and not simulation.asleep for one, simulation in zip(self._own, self.simulations, strict=True)]
        self.joined.take_pairs(self.pairs_finder.find(there, own))


def _factors(stiffness: Sequence[float], count: int) -> list[float]:
    """Return the factors on the stiffness of each organ's tissue: 1 if none are given."""
    if not len(stiffness):
        return [1.0] * count
    factors = finite(stiffness, count, "stiffness")
    if np.any(factors <= 0.0):
        raise UserError(f"stiffness is {factors.tolist()}; expected: factors greater than 0")
    return factors.tolist()
