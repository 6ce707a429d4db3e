"""Nearest points of triangles."""

from __future__ import annotations

import trimesh

from tissue_sim.organ.organ import Floats


def closest_points(corners: Floats, points: Floats) -> Floats:
    """Nearest point (k, 3) m of each triangle, corners (k, 3, 3) m, to its point, (k, 3) m.

    trimesh takes products of lengths below 1e-13 for zero, which those of fine meshes in metres are: it gets mm.
    """
    return trimesh.triangles.closest_point(1e3 * corners, 1e3 * points) * 1e-3
