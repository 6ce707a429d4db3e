"""Choice of organs that have a local region, and the tables that their models need."""

from __future__ import annotations

from tissue_sim.errors import UserError
from tissue_sim.model.data.model import Model
from tissue_sim.model.elasticity.adjacency import adjacency_of, with_cell_neighbours
from tissue_sim.model.elasticity.hop_distances import hop_table
from tissue_sim.model.regions.reduction import reduce_model
from tissue_sim.organ.organ import Organ

# Up to this number of cells, local_region auto moves the whole organ, which takes 0.3 ms a tick (`bench region`). A
# region is less accurate.
MAX_WHOLE_CELLS = 20_000


def moves_whole(organ: Organ) -> bool:
    """Return whether `auto` moves an organ's cells as a whole.

    Parameters
    ----------
    organ : Organ
        The organ.
    """
    return len(organ.cell_nodes) <= MAX_WHOLE_CELLS


def possible_region(organ: Organ, model: str, local_region: str) -> str:
    """Return the local region that a model of an organ has: `off` instead of `auto` if that always moves all of it.

    Parameters
    ----------
    organ : Organ
        The organ.
    model : str
        Name of the model.
    local_region : str
        One of LOCAL_REGIONS.

    Raises
    ------
    UserError
        Where the model has no such region.
    """
    of_cells = model == "cells"
    if of_cells and local_region == "frozen":
        raise UserError("a frozen region supports springs only; use local region off, modal or auto, or model hybrid")
    only_whole = organ.stiffening > 0.0 or organ.relaxation_fraction > 0.0
    if local_region == "auto" and ((of_cells and moves_whole(organ)) or only_whole):
        return "off"
    if local_region != "off" and only_whole:
        raise UserError("tissue that stiffens or relaxes moves as a whole; use local_region off or auto")
    return local_region


def with_region_tables(model: Model, local_region: str) -> Model:
    """Return the model with the tables that its local region needs.

    Parameters
    ----------
    model : Model
        Constants of the model.
    local_region : str
        off, frozen, modal or auto.
    """
    if local_region == "off":
        return model
    if model.tissue is None:
        model = model._replace(hops=hop_table(model))
    else:
        model = with_cell_neighbours(model)
    model = model._replace(adjacency=adjacency_of(model))
    if local_region == "frozen":
        return model
    return model._replace(reduction=reduce_model(model))
