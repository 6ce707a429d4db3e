"""Start of a calibration, and the transfer of its stiffness to an organ."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tissue_sim.array_types import Floats
from tissue_sim.errors import UserError
from tissue_sim.model.data.model import Model
from tissue_sim.model.elasticity.modes import strains_of
from tissue_sim.organ.cell_mesh import with_cells
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.topology import assemble_like

METHODS = ("cells", "groups")
# Interior atoms per surface node, where cells are fitted: more of them are slower and more accurate.
INTERIOR_FRACTION = {"fast": 0.3, "balanced": 0.75, "accurate": 1.5}
ONE_STEP = ("fast",)  # aims for which masses are fitted with the stiffness, so that a step of 1 ms is stable
CELL_LAYER = 0.7  # fraction of them in a layer under the surface
CELL_START = (1.0, 0.5)  # fractions of the tissue's mu and lambda at which the fit of cells begins
RETURN_START = 0.01  # fraction of the organ's return springs at which the search begins: the clamp holds the organ

_BOUNDS = {
    "seed": (0, 2**31),
    "cases": (8, 10_000),
    "evaluations": (1, 10_000),
    "smooth": (1, 1000),
    "sharp": (0, 1000),
}


@dataclass(frozen=True)
class Settings:
    """What a calibration is made with.

    cases: linear loads of the fit; smooth and sharp: held-out ones; evaluations: of the misfit; interior: atoms in the
    result, None for as many as `aim` asks for, most of them in a layer under the surface (for groups the organ's own,
    as in the paper). Raises UserError for a number out of range and for an unknown method or aim.
    """

    seed: int = 0
    method: str = "cells"
    aim: str = "balanced"
    cases: int = 1600
    evaluations: int = 100
    interior: int | None = None
    smooth: int = 30
    sharp: int = 10

    def __post_init__(self) -> None:
        for name, (least, most) in _BOUNDS.items():
            value = getattr(self, name)
            if not least <= value <= most:
                raise UserError(f"{name} {value} is outside {least}..{most}")
        if self.interior is not None and self.interior < 0:
            raise UserError(f"interior {self.interior} is negative; use 0 or more")
        if self.method not in METHODS:
            raise UserError(f"unknown method '{self.method}'; choose one of {', '.join(METHODS)}")
        if self.aim not in INTERIOR_FRACTION:
            raise UserError(f"unknown aim '{self.aim}'; choose one of {', '.join(INTERIOR_FRACTION)}")


def prepared(organ: Organ, settings: Settings) -> Organ:
    """Return the organ with the wanted interior atoms, and with cells where those are fitted.

    Parameters
    ----------
    organ : Organ
        The organ.
    settings : Settings
        Settings of the calibration.

    Raises
    ------
    UserError
        For an unknown method or aim.
    """
    by_cells = settings.method == "cells"
    interior = settings.interior
    if interior is None:
        interior = round(INTERIOR_FRACTION[settings.aim] * organ.n_surface) if by_cells else organ.n_interior
    if interior != organ.n_interior or by_cells:
        provenance = {key: value for key, value in organ.provenance.items() if key != "calibration"}
        organ = assemble_like(
            organ,
            interior_atoms=interior,
            interior_layer=CELL_LAYER if by_cells else 0.0,
            provenance={**provenance, "interior_atoms": interior},
        )
    return with_cells(organ, CELL_START) if by_cells else without_cells(organ)


def without_cells(organ: Organ) -> Organ:
    """Return the organ with springs alone."""
    return replace(organ, cell_nodes=organ.cell_nodes[:0], cell_mu=organ.cell_mu[:0], cell_lambda=organ.cell_lambda[:0])


def first_stiffness(organ: Organ, model: Model) -> Floats:
    """Return the stiffness at which a fit begins: the organ's, its return springs weakened.

    Parameters
    ----------
    organ : Organ
        The organ.
    model : Model
        The organ's model.

    Returns
    -------
    Floats, shape (p,)
        Stiffness, in the order of strains_of.
    """
    if model.tissue is not None:
        return np.concatenate([organ.cell_mu, organ.cell_lambda])
    stiffness = strains_of(model).stiffness.copy()
    stiffness[len(stiffness) - len(model.return_nodes) :] *= RETURN_START
    return stiffness


def with_stiffness(organ: Organ, model: Model, stiffness: Floats) -> Organ:
    """Return the organ with another stiffness.

    Parameters
    ----------
    organ : Organ
        The organ.
    model : Model
        The organ's model.
    stiffness : Floats, shape (p,)
        Stiffness in the order of strains_of.
    """
    if model.tissue is not None:
        mu, lam = stiffness.reshape(2, -1)
        return replace(organ, cell_mu=mu, cell_lambda=lam)
    bounds = np.cumsum([len(model.spring_first), len(model.angular_nodes)])
    axial, angular, pulls = np.split(stiffness, bounds)
    spring, hinge, pull = (
        np.array(values) for values in (organ.spring_stiffness, organ.angular_stiffness, organ.return_stiffness)
    )
    spring[spring > 0.0] = axial
    hinge[hinge > 0.0] = angular
    pull[model.return_nodes] = pulls
    # Nothing reads those of held nodes, but the file would keep their old values.
    pull[organ.fixed] = 0.0
    return replace(organ, spring_stiffness=spring, angular_stiffness=hinge, return_stiffness=pull)
