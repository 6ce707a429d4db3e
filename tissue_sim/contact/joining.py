"""What joins the organs of a scene: attachments, the breath, and that they touch each other."""

from __future__ import annotations

from collections.abc import Sequence

from tissue_sim.contact.attachments import Attachment, Breathing, links_of
from tissue_sim.model.breathing import Breath
from tissue_sim.model.pairs import make_pairs
from tissue_sim.model.simulation import Simulation
from tissue_sim.model.together import Joined


def join(
    simulations: Sequence[Simulation],
    attachments: Sequence[Attachment] = (),
    breathing: Breathing | None = None,
    breathes: Sequence[float] = (),
    friction: float = 0.0,
) -> Joined:
    """Join simulations.

    breathes (k,): how far the clamp of each goes with the breath; friction: Coulomb coefficient between organs.
    Raises UserError where they don't fit together.
    """
    breath = Breath.new() if breathing is None else breathing.breath()
    return Joined(simulations, links_of(attachments, simulations), make_pairs(friction), breath, breathes)
