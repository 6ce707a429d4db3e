"""Closed surfaces of few triangles around what a mask marks as an inclusion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import ndimage

from tissue_sim.errors import UserError
from tissue_sim.organ.imaging.image import Volume
from tissue_sim.organ.inclusions import Inclusion, check_stiffness
from tissue_sim.organ.surface_checks import signed_volume
from tissue_sim.organ.surfaces.marching_cubes import marching_cubes_surface
from tissue_sim.organ.surfaces.resample import thin_out
from tissue_sim.organ.surfaces.surface import make_wall

POINTS = 400  # of one surface at most
LEAST_VOXELS = 50  # of a part, as make_wall has it


def surround(mask: Volume, stiffness: float) -> tuple[list[Inclusion], int]:
    """Return each part of a mask as an inclusion, the largest first.

    Parameters
    ----------
    mask : Volume
        The voxels of the organ.
    stiffness : float
        Factor of the tissue's moduli.

    Returns
    -------
    tuple[list[Inclusion], int]
        The inclusions, and how many parts are too small for one.

    Raises
    ------
    UserError
        Where no part is large enough, and for a stiffness out of range.
    """
    check_stiffness(stiffness)
    mask = mask.upright()
    labels, count = ndimage.label(mask.array, structure=np.ones((3, 3, 3)))
    sizes = np.bincount(labels.ravel(), minlength=count + 1)[1:]
    order = np.argsort(-sizes, kind="stable")
    large = [int(part) + 1 for part in order if sizes[part] >= LEAST_VOXELS]
    if not large:
        raise UserError(f"{mask.name}: an inclusion needs at least {LEAST_VOXELS} connected voxels; use a finer image")
    return [_surface(replace(mask, array=labels == part), stiffness) for part in large], count - len(large)


def _surface(mask: Volume, stiffness: float) -> Inclusion:
    wall = make_wall(mask)
    positions, triangles = marching_cubes_surface(wall)
    while len(positions) > POINTS:
        fewer, left = thin_out(positions, triangles, len(positions) - POINTS)
        if len(fewer) == len(positions):
            break
        positions, triangles = fewer, left
    # Smoothing takes a tenth of what is a few voxels large; the mask knows how large it is.
    wanted = 1e3 * mask.voxel_volume * np.count_nonzero(mask.array)  # mm^3
    middle = positions.mean(axis=0)
    positions = middle + np.cbrt(wanted / signed_volume(positions, triangles)) * (positions - middle)
    return Inclusion(wall.to_patient(positions), wall.outward(triangles), stiffness)
