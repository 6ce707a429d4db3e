"""Organ that tools may touch: its simulation and its contact sets."""

from __future__ import annotations

import copy

import numpy as np

from tissue_sim.array_types import Floats
from tissue_sim.contact.blade_cuts import BladeCuts
from tissue_sim.contact.finder import ContactFinder, ContactQuery
from tissue_sim.contact.reach_margins import reach_margins
from tissue_sim.contact.tools import ToolSet
from tissue_sim.model.data.contact_set import ContactSet, Engaged
from tissue_sim.model.simulation import Simulation


class ContactOrgan:
    """Simulation whose contact sets are found every `ticks_a_set` ticks.

    Parameters
    ----------
    tools : ToolSet
        The tools.
    ticks_a_set : int
        Number of ticks for which a contact set is used.
    simulation : Simulation
        The simulation.
    """

    def __init__(self, simulation: Simulation, tools: ToolSet, ticks_a_set: int) -> None:
        self.simulation = self._uncut = simulation
        self.finder = self._uncut_finder = ContactFinder.of(simulation, tools)
        self.contacts: ContactSet | None = None
        self._ticks_a_set = ticks_a_set
        self.blade_cuts = BladeCuts(simulation, tools.coagulations)
        self.set_goal: Floats | None = None  # the bodies' poses at the last contact set

    def with_simulation(self, simulation: Simulation) -> ContactOrgan:
        """Return an organ with another simulation that shares the finder of this one, which has no cuts.

        Parameters
        ----------
        simulation : Simulation
            The simulation.
        """
        made = copy.copy(self)
        made.simulation = made._uncut = simulation
        made.contacts = None
        return made

    def exchange(self, simulation: Simulation) -> None:
        """Continue with a simulation of the same organ after a cut, and with its surface.

        Parameters
        ----------
        simulation : Simulation
            The simulation.
        """
        self.simulation = simulation
        self.finder = ContactFinder.of(simulation, self.finder.tools)
        self.contacts = None

    def heal(self) -> bool:
        """Return to the simulation before the first cut, with the present settings; return whether there was one."""
        if self.simulation is self._uncut:
            return False
        self._uncut.return_from(self.simulation)
        self._uncut.continue_from(self.simulation)
        self._uncut.set_substeps()
        self.simulation, self.finder, self.contacts = self._uncut, self._uncut_finder, None
        return True

    def reset(self) -> None:
        """Return to rest, untouched; the settings don't change."""
        self.simulation.reset()
        self.contacts = self.set_goal = None
        self.blade_cuts.forget()

    def find(self, sequence: int) -> None:
        """Find the points that the bodies may touch at present, and apply them.

        Parameters
        ----------
        sequence : int
            Number of the contact set.
        """
        state = self.simulation.state
        fresh = ((state.bodies.age >= 0) & (state.bodies.released == 0)).astype(np.int64)
        fresh[(fresh > 0) & state.bodies.cutting] = Engaged.CUTS
        pushing = (state.bodies.force_age >= 0).astype(np.int64)
        goal, places = state.body_goal.copy(), state.body_pose.copy()
        # A set before every tick contains all points on a tool's path; otherwise also those that it may reach until the
        # next set.
        fraction, last = (0.0, goal) if self._ticks_a_set == 1 or self.set_goal is None else (2.0, self.set_goal)
        margins = reach_margins(places, goal, last, fraction, self.finder.tools.shapes.extent)
        self.set_goal = goal
        releases = state.bodies.releases.copy()
        found = self.finder.find(self.simulation.positions, ContactQuery(places, margins, fresh, pushing, releases))
        self.simulation.take_contacts(found, sequence)
        self.contacts = found
