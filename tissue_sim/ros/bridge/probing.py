"""Where a sphere meets a rest surface: what the scripted bridge needs to plan its path."""

from __future__ import annotations

import numpy as np

from tissue_sim.array_types import Floats, Longs
from tissue_sim.contact.triangles import closest_points


class Surface:
    """A closed triangle mesh to be probed: vertices (n, 3) m, triangles (t, 3), counter-clockwise from outside."""

    def __init__(self, vertices: Floats, triangles: Longs) -> None:
        self.vertices = np.asarray(vertices, dtype=np.float64)
        self.triangles = np.asarray(triangles, dtype=np.int64)
        self._corners = self.vertices[self.triangles]
        edge1 = self._corners[:, 1] - self._corners[:, 0]
        edge2 = self._corners[:, 2] - self._corners[:, 0]
        self._edges = edge1, edge2
        self._area_normals = np.cross(edge1, edge2)
        self._centres = self._corners.mean(axis=1)
        self._reach = np.linalg.norm(self._corners - self._centres[:, None], axis=2).max(axis=1)

    def samples(self, above: float, at_most: int) -> tuple[Floats, Floats]:
        """Centres (m, 3) of triangles higher than z = `above` m, and their outward unit normals (m, 3)."""
        chosen = np.flatnonzero(self._centres[:, 2] > above)
        if len(chosen) > at_most:
            chosen = chosen[np.linspace(0, len(chosen) - 1, at_most).astype(np.int64)]
        return self._centres[chosen], self.triangle_normals(chosen)

    def closest(self, point: Floats) -> tuple[float, Floats]:
        """Distance m from a point (3,) to the surface (not signed), and the nearest surface point (3,)."""
        to_centre = np.linalg.norm(self._centres - point, axis=1)
        # No triangle is farther than its farthest corner, nor nearer than its centre less its reach.
        near = to_centre - self._reach <= (to_centre + self._reach).min()
        found = closest_points(self._corners[near], np.broadcast_to(point, (int(near.sum()), 3)))
        distance = np.linalg.norm(found - point, axis=1)
        best = int(distance.argmin())
        return float(distance[best]), found[best]

    def advance(self, start: Floats, direction: Floats, clearance: float, longest: float) -> Floats | None:
        """Move a point from outside along a unit direction until it is `clearance` m from the surface.

        Returns where it stops (3,), or None when it passes the organ within `longest` m.
        Sphere tracing: each step is as long as the distance allows.
        """
        travelled = 0.0
        for _ in range(500):
            point = start + travelled * direction
            gap = self.closest(point)[0] - clearance
            if gap < 1e-6:
                return point
            travelled += gap
            if travelled > longest:
                return None
        return None

    def cast(self, origins: Floats, directions: Floats) -> tuple[Floats, Longs]:
        """First hit of rays (m, 3), (m, 3): distance (m,) in units of the direction, inf where none, and triangle (m,).

        Möller and Trumbore (1997).
        """
        edge1, edge2 = self._edges
        distance = np.full(len(origins), np.inf)
        triangle = np.full(len(origins), -1, dtype=np.int64)
        for ray, (origin, direction) in enumerate(zip(origins, directions, strict=True)):
            p = np.cross(direction, edge2)
            determinant = np.einsum("ij,ij->i", edge1, p)
            with np.errstate(divide="ignore", invalid="ignore"):
                from_corner = origin - self._corners[:, 0]
                u = np.einsum("ij,ij->i", from_corner, p) / determinant
                q = np.cross(from_corner, edge1)
                v = q @ direction / determinant
                t = np.einsum("ij,ij->i", edge2, q) / determinant
                hit = (u >= -1e-9) & (v >= -1e-9) & (u + v <= 1.0 + 1e-9) & (t > 1e-9)
            t = np.where(hit, t, np.inf)
            nearest = int(t.argmin())
            if np.isfinite(t[nearest]):
                distance[ray], triangle[ray] = t[nearest], nearest
        return distance, triangle

    def triangle_normals(self, triangles: Longs) -> Floats:
        """Outward unit normals (m, 3) of triangles (m,)."""
        normals = self._area_normals[triangles]
        return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
