"""How far points are from a surface, by trimesh."""

import numpy as np
import trimesh


def clearance(vertices: np.ndarray, triangles: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Distances (m,) m of points (m, 3) from a surface (n, 3) m, (t, 3)."""
    mesh = trimesh.Trimesh(vertices, triangles, process=False)
    return trimesh.proximity.closest_point_naive(mesh, np.atleast_2d(points))[1]
