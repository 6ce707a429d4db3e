"""Organ with an identified stiffness."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from tissue_sim.array_types import Floats
from tissue_sim.errors import UserError
from tissue_sim.organ.organ import Organ

KEY = "identified"  # in the provenance


def with_stiffness(organ: Organ, factor: float, record: Mapping[str, object], of_cells: Floats | None = None) -> Organ:
    """Return an organ whose tissue is stiffer by a factor, and keeps its damping ratio.

    Parameters
    ----------
    organ : Organ
        The organ.
    factor : float
        Factor on all moduli and springs.
    record : Mapping[str, object]
        What it was identified from, for the provenance.
    of_cells : Floats | None, optional
        Further factors on the cells' moduli, (c,).

    Raises
    ------
    UserError
        For a map on an organ without cells.
    """
    if of_cells is not None and not len(organ.cell_nodes):
        raise UserError(f"organ '{organ.name}' has no cells to hold a map; calibrate it first")
    cells = factor * (np.ones(len(organ.cell_nodes)) if of_cells is None else of_cells)
    return replace(
        organ,
        youngs_modulus=factor * organ.youngs_modulus,
        cell_mu=cells * organ.cell_mu,
        cell_lambda=cells * organ.cell_lambda,
        spring_stiffness=factor * organ.spring_stiffness,
        angular_stiffness=factor * organ.angular_stiffness,
        return_stiffness=factor * organ.return_stiffness,
        damping=np.sqrt(factor) * organ.damping,
        provenance={**organ.provenance, KEY: dict(record)},
    )
