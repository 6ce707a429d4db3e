"""Nearest points of triangles."""

from __future__ import annotations

import numpy as np
import trimesh

from tissue_sim.organ.organ import Floats


def closest_points(corners: Floats, points: Floats) -> Floats:
    """Nearest point (k, 3) m of each triangle, corners (k, 3, 3) m, to its point, (k, 3) m.

    trimesh takes products of lengths below 1e-13 for zero, which those of fine meshes in metres are: it gets mm.
    """
    return trimesh.triangles.closest_point(1e3 * corners, 1e3 * points) * 1e-3


def nearest_weights(corners: Floats, points: Floats) -> tuple[Floats, Floats]:
    """Nearest point of each triangle, corners (k, 3, 3) m, to its point, (k, 3) m.

    Returns the barycentric weights (k, 3) and the distances (k,) m.
    """
    nearest = closest_points(corners, points)
    weights = trimesh.triangles.points_to_barycentric(corners, nearest)
    # A triangle without area has no such weights: its nearest corner stands for it.
    flat = ~np.all(np.isfinite(weights), axis=1)
    if np.any(flat):
        corner = np.argmin(np.linalg.norm(corners[flat] - points[flat, None], axis=2), axis=1)
        weights[flat] = np.eye(3)[corner]
        nearest[flat] = corners[flat, corner]
    return weights, np.linalg.norm(nearest - points, axis=1)
