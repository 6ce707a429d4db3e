"""An organ whose surface has more points in some places, and exactly the same shape: edges are halved."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from tissue_sim.array_types import Floats, Longs
from tissue_sim.errors import UserError
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.refinement import Refinement, wanted_edges
from tissue_sim.organ.surfaces.grading import split_in_place
from tissue_sim.organ.tool_resolution import MOST_POINTS
from tissue_sim.organ.topology import assemble_like

_NEAR = 24  # triangles in which a point is looked for
_ON = 1e-6  # relative: how far outside its triangle rounding may put a point


def refined(organ: Organ, refinement: Refinement) -> Organ:
    """Return an organ with shorter edges of the surface in some places.

    Its shape stays exactly, since edges are only halved, so that results of finite elements for the one hold for the
    other. Its nodes keep their numbers within the surface; what lies inside is made again, and must be calibrated
    again.

    Parameters
    ----------
    organ : Organ
        The organ, with springs or cells.
    refinement : Refinement
        Where edges are to be shorter.

    Returns
    -------
    Organ
        The organ, with springs.

    Raises
    ------
    UserError
        When it would have too many points, or nothing would change.
    """
    before, triangles = organ.surface_positions, organ.surface_triangles
    wanted = wanted_edges(refinement, before, triangles, organ.fixed)
    positions, made = split_in_place(before, triangles, wanted, MOST_POINTS)
    if len(positions) == len(before):
        raise UserError(f"--refine changes nothing: the edges of organ '{organ.name}' are as short already")
    held = np.zeros(len(before), dtype=bool)
    held[organ.fixed] = True
    corner, fraction = places_on(organ, positions)
    # The middle of an edge is held where both ends are.
    fixed = np.flatnonzero(np.where(held[corner], fraction, 0.0).sum(axis=1) > 1.0 - _ON).astype(np.int32)
    provenance = {key: value for key, value in organ.provenance.items() if key != "calibration"}
    return assemble_like(
        organ,
        surface_positions=positions,
        surface_triangles=made,
        fixed=fixed,
        interior_atoms=0,
        provenance={**provenance, "refined_from_points": len(before)},
    )


def places_on(organ: Organ, points: Floats) -> tuple[Longs, Floats]:
    """Return between which surface nodes points on an organ's surface lie, and their fractions.

    Parameters
    ----------
    organ : Organ
        The organ.
    points : Floats, shape (k, 3), m
        Points on its surface.

    Returns
    -------
    tuple[Longs, Floats]
        Corners of a triangle for each, shape (k, 3), and the barycentric coordinates in it, shape (k, 3).

    Raises
    ------
    UserError
        Where a point isn't on the surface.
    """
    triangles = organ.surface_triangles.astype(np.int64)
    corner = organ.surface_positions[triangles]
    near = cKDTree(corner.mean(axis=1)).query(points, k=min(_NEAR, len(corner)))[1].reshape(len(points), -1)
    a, one, other = corner[near][:, :, 0], *(corner[near][:, :, k] - corner[near][:, :, 0] for k in (1, 2))
    normal = np.cross(one, other)
    square = np.einsum("knx,knx->kn", normal, normal)
    away = points[:, None] - a
    second = np.einsum("knx,knx->kn", np.cross(away, other), normal) / square
    third = np.einsum("knx,knx->kn", np.cross(one, away), normal) / square
    fraction = np.stack([1.0 - second - third, second, third], axis=2)
    off = np.abs(np.einsum("knx,knx->kn", away, normal)) / square**0.75  # of the triangle's size
    fit = fraction.min(axis=2) - off
    best = np.argmax(fit, axis=1)
    row = np.arange(len(points))
    if np.any(fit[row, best] < -_ON):
        raise UserError(f"a point does not lie on the surface of organ '{organ.name}'")
    return triangles[near[row, best]], np.clip(fraction[row, best], 0.0, 1.0)
