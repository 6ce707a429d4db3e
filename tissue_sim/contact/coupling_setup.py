"""Coupling of the organs of a scene: attachments, breathing, and contact with each other."""

from __future__ import annotations

from collections.abc import Sequence

from tissue_sim.contact.attachments import Attachment, Breathing, links_of
from tissue_sim.model.joined import Joined
from tissue_sim.model.simulation import Simulation
from tissue_sim.model.stepping.breathing import Breath
from tissue_sim.model.stepping.contact_pairs import make_organ_contacts


def join(
    simulations: Sequence[Simulation],
    attachments: Sequence[Attachment] = (),
    breathing: Breathing | None = None,
    breathes: Sequence[float] = (),
    friction: float = 0.0,
) -> Joined:
    """Return coupled simulations.

    Parameters
    ----------
    simulations : Sequence[Simulation]
        Simulations of the organs.
    attachments : Sequence[Attachment], optional
        Attachments of the organs.
    breathing : Breathing | None, optional
        Breathing; None for none.
    breathes : Sequence[float], shape (k,), optional
        Motion of each clamp with the breath, as a factor.
    friction : float, optional
        Coulomb coefficient between organs.

    Raises
    ------
    UserError
        Where they don't fit together.
    """
    breath = Breath.new() if breathing is None else breathing.breath()
    return Joined(simulations, links_of(attachments, simulations), make_organ_contacts(friction), breath, breathes)
