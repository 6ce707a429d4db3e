"""Check whether an organ's surface is fine enough for the thickness of the organ."""

from __future__ import annotations

import math

import numpy as np

from tissue_sim.errors import UserError
from tissue_sim.organ.organ import Organ

THIN = 0.1  # fraction of the medial atoms that may lie in thinner tissue
# Mean edges of the surface over the medial radius there. Organs that calibrate well have up to 0.78; a colon of 1.2
# had held-out errors of 4 % on average and 26 % at worst. A finer surface is required so that some margin is left.
MOST, ROOM = 1.0, 0.8


def check_thickness(organ: Organ) -> None:
    """Raise UserError for an organ that is too thin for the triangles around it.

    Parameters
    ----------
    organ : Organ
        The organ.

    Raises
    ------
    UserError
        Where it is too thin; the message gives the number of points that is needed.
    """
    corner = organ.surface_positions[organ.surface_triangles]
    edge = float(np.linalg.norm(corner - np.roll(corner, 1, axis=1), axis=2).mean())
    radius = float(np.quantile(organ.atom_radius, THIN)) if organ.n_atoms else math.inf
    if edge > MOST * radius:
        points = organ.n_surface * (edge / (ROOM * radius)) ** 2
        raise UserError(
            f"organ '{organ.name}' is {2e3 * radius:.1f} mm thick in places, too thin for triangles with edges of"
            f" {1e3 * edge:.1f} mm; build it with --points {math.ceil(points / 100.0) * 100}"
        )
