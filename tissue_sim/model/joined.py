"""Simulations of the organs of a scene, which are advanced together, and their coupling."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tissue_sim.array_types import Floats
from tissue_sim.errors import UserError
from tissue_sim.handles import handle, row
from tissue_sim.model.contact.haptic_output import sum_haptic_output
from tissue_sim.model.data.links import Links, make_links
from tissue_sim.model.data.records import words_of
from tissue_sim.model.data.settings import Settings
from tissue_sim.model.simulation import Simulation
from tissue_sim.model.stepping.breathing import Breath, moves_with_frame
from tissue_sim.model.stepping.coarse_steps import coarse_masses, no_coarse
from tissue_sim.model.stepping.contact_pairs import (
    MAX_ORGANS,
    OrganContacts,
    OrganContactSet,
    make_organ_contacts,
    renew_surface,
    take_pairs,
)
from tissue_sim.model.stepping.coupled_step import CoupledOrgans, tick_coupled, uncouple
from tissue_sim.model.stepping.ligament_links import compute_link_bounds, least_substeps
from tissue_sim.model.stepping.wake_threshold import WAKE_DISPLACEMENT, wake_threshold_of


class ExchangePlan(NamedTuple):
    """Changes for all organs of a scene when one organ continues with another simulation; l links."""

    coarse_square: float  # (rad/s)^2, squared largest frequency of its coarse steps; 0: it takes none
    lightness: Floats  # (l,) see Links
    added: float  # see Links
    version: int  # of the organ's surface, see OrganContacts


class Joined:
    """Simulations that are advanced together: one, or several.

    links: links between them; pairs: pairs where they touch, found by others; breath, moves: breathing, and the
    fraction of its displacement for each organ, (k,), or nothing without any. wake_displacement: m, largest
    displacement by loads of links and the breath that are left out, see `wake_threshold`; 0: none are. Raises UserError
    if simulations don't fit together. worlds and handle are the arguments of `tick_coupled`.

    alone: a single organ without coupling. Then handle is None, and kernels are compiled without coupling.
    """

    def __init__(
        self,
        simulations: Sequence[Simulation],
        links: Links | None = None,
        pairs: OrganContacts | None = None,
        breath: Breath | None = None,
        moves: Sequence[float] = (),
        wake_displacement: float = WAKE_DISPLACEMENT,
    ) -> None:
        self.simulations = list(simulations)
        self.alone = len(self.simulations) == 1 and links is None and pairs is None and breath is None
        self.links = make_links(0) if links is None else links
        self.pairs = make_organ_contacts() if pairs is None else pairs
        breath = Breath.new() if breath is None else breath
        if len(self.simulations) > MAX_ORGANS:
            raise UserError(f"{len(self.simulations)} organs are joined; expected: at most {MAX_ORGANS}")
        if len({(one.rate, one.variant, one.local_region, one.integrator) for one in simulations}) > 1:
            raise UserError("the organs of a scene must have the same rate, model, local region and integrator")
        moves = list(moves) or [0.0] * len(self.simulations)
        if len(moves) != len(self.simulations):
            raise UserError(
                f"the organs' breathing fractions are {len(moves)} numbers for {len(self.simulations)} organs"
            )
        gravity = np.array([gravity_of(one.settings) for one in self.simulations])
        self.carried = moves_with_frame(breath, moves, gravity)
        ways = np.outer(moves, [breath.x, breath.y, breath.z])
        models = [one.model for one in self.simulations]
        self.threshold = wake_threshold_of(models, self.links, ways, wake_displacement)
        self.worlds = row([one.world for one in self.simulations])
        self.coarse = no_coarse(len(moves))
        rest = self.coarse, np.zeros(len(moves), dtype=np.int64)
        coupled = CoupledOrgans(self.carried, self.links, self.pairs, self.threshold, *rest)
        self.handle = None if self.alone else handle(coupled)
        self.set_substeps()
        if len(moves) > 1 and wake_displacement > 0.0:
            for organ, one in enumerate(self.simulations):
                factor, frequency = coarse_masses(one.model, one.settings, float(self.links.added[0]))
                one.scratch.coarse[:] = factor
                self.coarse.square[organ] = frequency**2

    def plan_exchange(self, organ: int, made: Simulation) -> ExchangePlan:
        """Return the changes for all organs when one continues with another simulation, after a cut.

        Nodes keep their indices, so that links don't change, nor does contact with other organs, except at the walls
        and lips of cuts.

        Parameters
        ----------
        organ : int
            Index of the organ.
        made : Simulation
            The simulation; its coarse steps are planned.
        """
        links, square = self.links._replace(lightness=self.links.lightness.copy(), added=self.links.added.copy()), 0.0
        if len(links.slack):
            each = [*self.simulations[:organ], made, *self.simulations[organ + 1 :]]
            compute_link_bounds(links, [one.model.inverse_mass for one in each])
        if self.coarse.square[organ] > 0.0:
            factor, frequency = coarse_masses(made.model, made.settings, float(links.added[0]))
            made.scratch.coarse[:] = factor
            square = frequency**2
        return ExchangePlan(square, links.lightness, float(links.added[0]), int(self.pairs.version[organ]) + 1)

    def exchange(self, organ: int, made: Simulation, plan: ExchangePlan) -> None:
        """Continue with another simulation of an organ, after a cut; the number of substeps doesn't change.

        Parameters
        ----------
        organ : int
            Index of the organ.
        made : Simulation
            The simulation.
        plan : ExchangePlan
            Result of `plan_exchange`.
        """
        self.coarse.square[organ] = plan.coarse_square
        self.links.lightness[:], self.links.added[0] = plan.lightness, plan.added
        renew_surface(self.pairs, organ, plan.version)
        self.simulations[organ] = made
        self.worlds = row([one.world for one in self.simulations])

    def step(self) -> None:
        """Advance all by one tick."""
        if self.alone:
            self.simulations[0].step()
        else:
            tick_coupled(self.worlds, self.handle)

    @property
    def wrench(self) -> Floats:
        """Haptic output of every body of the tools, summed over all organs, (b, 6) N and N m about its origin.

        For a single organ it is the live array.
        """
        if self.alone:
            return np.asarray(self.simulations[0].state.wrench)
        wrench = np.zeros_like(self.simulations[0].state.wrench)
        sum_haptic_output(self.worlds, wrench)
        return wrench

    def set_substeps(self) -> None:
        """Compute the substeps of all organs and those required by links, after stiffness, damping or rate changed."""
        for one in self.simulations:
            one.set_substeps()
        least = least_substeps(self.links, fastest(self.simulations), float(self.simulations[0].settings.tick_time))
        for one in self.simulations:
            one.settings.least_substeps = least

    def take_pairs(self, found: OrganContactSet) -> None:
        """Apply a set of pairs where organs touch each other.

        Parameters
        ----------
        found : OrganContactSet
            The pairs.
        """
        take_pairs(self.pairs, found)

    def take_settings(self, organ: int, settings: Settings) -> None:
        """Apply settings of an organ that were computed before; their gravity doesn't include the breath's part.

        Parameters
        ----------
        organ : int
            Index of the organ.
        settings : Settings
            The settings.
        """
        self.simulations[organ].take_settings(settings)
        self.carried.gravity[organ] = gravity_of(settings)

    def note_gravity(self) -> None:
        """Store the gravity of the simulations as that without breath."""
        for one, gravity in zip(self.simulations, self.carried.gravity, strict=True):
            gravity[:] = gravity_of(one.settings)

    def set_breathing(self, fraction: float) -> None:
        """Set the target of a breath that follows a signal.

        Parameters
        ----------
        fraction : float
            Fraction of its displacement.
        """
        self.carried.breath.target = fraction

    def restore(self, breath: Breath, found: OrganContactSet, pressed: Floats, held: Floats) -> None:
        """Restore a breath, and pairs with their forces.

        Parameters
        ----------
        breath : Breath
            The breath.
        found : OrganContactSet
            The pairs.
        pressed : Floats, shape (p,), N
            Normal force of each pair.
        held : Floats, shape (p, 3), N
            Friction of each pair.
        """
        count = int(found.found[0])
        self.pairs.found[0] = 0
        self.take_pairs(found)
        self.pairs.pressed[:count], self.pairs.held[:count] = pressed[:count], held[:count]
        words_of(self.carried.breath)[:] = words_of(breath)

    def reset(self) -> None:
        """Return to the exhaled state without contact between organs; simulations are reset separately."""
        if not self.alone:
            uncouple(self.worlds, self.handle)


def gravity_of(settings: Settings) -> tuple[float, float, float]:
    """Return the gravity, m/s^2."""
    return settings.gravity_x, settings.gravity_y, settings.gravity_z


def fastest(simulations: Sequence[Simulation]) -> float:
    """Return the largest angular frequency of all simulations, rad/s."""
    return max(one.frequency * math.sqrt(one.settings.stiffness_scale) for one in simulations)
