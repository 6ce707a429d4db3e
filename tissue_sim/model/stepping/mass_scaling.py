"""Selective mass scaling: nodes of compressed cells are heavier for a while, instead of halved substeps.

A compressed cell is stiffer, so that its nodes may oscillate in a substep that is short enough for all others. Four
times their mass halves their frequency, which has the same effect as halved substeps without doubling the time of a
tick. Only few nodes are heavier, around a blade that presses slowly, so that their inertia has hardly any effect.
Masses are computed from the positions alone: nothing else has to be recorded for a replay.

References
----------
Olovsson, Simonsson and Unosson 2005, Selective mass scaling for explicit finite element analyses.
"""

from __future__ import annotations

from typing import Any

from tissue_sim.array_types import Floats
from tissue_sim.handles import has
from tissue_sim.jit import chosen, kernel
from tissue_sim.model.contact.volume_limit import has_compressed_cells, volume_of
from tissue_sim.model.data.model import Model
from tissue_sim.model.data.state import Region, State
from tissue_sim.model.elasticity.cell_groups import listed_cell
from tissue_sim.model.elasticity.cell_law import COMPRESSED

LARGEST = 4.0  # factor on masses, which halves frequencies
# Difference between COMPRESSED and the volume ratio at which a cell's nodes have that factor. The factor grows
# gradually: masses that change suddenly while nodes oscillate would feed the oscillation.
RANGE = 0.3


@kernel
def can_be_cut(model: Model, state: State) -> bool:
    """Return whether the organ has cuts, and therefore light nodes, or a blade can touch it, which makes deep dents.

    Parameters
    ----------
    model : Model
        Constants of the model.
    state : State
        State of the simulation.
    """
    return len(model.lips.weight) > 0 or len(state.blades) > 0


@kernel
def is_mass_scaled(model: Model, state: State) -> bool:
    """Return whether nodes of compressed cells are heavier in this tick, since nodes have oscillated.

    Only the whole organ's masses are scaled, after the forces of this tick's first substep have been computed.

    Parameters
    ----------
    model : Model
        Constants of the model.
    state : State
        State of the simulation.
    """
    status = state.status
    if status.region != Region.WHOLE or status.oscillating == 0:
        return False
    return has_compressed_cells(model) and can_be_cut(model, state)


@kernel
def _of_cells(model: Model, position: Floats, factor: Floats) -> None:
    tissue: Any = model.tissue
    factor[:] = 1.0
    for index in range(tissue.stiff[0]):
        corners, inverse, _ = listed_cell(tissue, index)
        short = (COMPRESSED - volume_of(position, corners, inverse)) / RANGE
        scale = 1.0 + (LARGEST - 1.0) * min(1.0, max(0.0, short))
        for corner in corners:
            factor[corner] = max(factor[corner], scale)


@kernel
def _of_springs(model: Model, position: Floats, factor: Floats) -> None:
    factor[:] = 1.0


@chosen(lambda model, *_: _of_cells if has(model, "tissue") else _of_springs)
def write_mass_factors(model: Model, position: Floats, factor: Floats) -> Any:
    """Write the factors on the nodes' masses: more than 1 for those of compressed cells.

    Parameters
    ----------
    model : Model
        Constants of the model, and the cells that the last forces found compressed.
    position : Floats, shape (n, 3), m
        Positions of the nodes, for which these forces were.
    factor : Floats, shape (n,)
        The factors; updated.
    """
