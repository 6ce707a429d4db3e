"""One body at several point counts, and the transfer of loads and displacements between their surfaces.

The body is the solid inside one organ's surface. A finer surface is that surface with its triangles divided: the same
polyhedron, the same clamp. A coarser one is made by the pipeline: voxels, wall, balloon; it is held where the organ's
nearest points are. All keep the organ's atoms and tissue.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array
from scipy.spatial import cKDTree
from trimesh.remesh import subdivide

from tissue_sim.array_types import Floats, Ints, Longs
from tissue_sim.contact.triangles import nearest_among
from tissue_sim.model.elasticity.diagonal import diagonal
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.surfaces.resample import thicken
from tissue_sim.organ.topology import assemble_like, node_area
from tissue_sim.result_cache import remembered

_PASS = 0.12  # fraction of the points that a pass of halving adds: roughly the longest edges first
_ON_PLANE = 1e-9  # of the body's length: distance within which a point lies on a triangle
_VERSION = "2"  # version of what is cached


@dataclass(frozen=True, eq=False)
class Sized:
    """Body at one point count: its organ (n points) and its relation to the reference's surface (m points).

    Attributes
    ----------
    organ : Organ
        The organ.
    reference : Organ
        The reference.
    follow : csr_array, shape (m, n)
        Displacements of the reference's points, each of which follows the nearest place on the organ's surface.
    lead : csr_array, shape (n, m)
        The same in the other direction.
    """

    organ: Organ
    reference: Organ
    follow: csr_array
    lead: csr_array

    @cached_property
    def _areas(self) -> tuple[Floats, Floats]:
        mine, theirs = (
            node_area(one.surface_positions, one.surface_triangles)[:, None] for one in (self.organ, self.reference)
        )
        return mine, theirs

    def forces(self, force: Floats) -> Floats:
        """Return forces (n, 3) N of the reference's forces (m, 3) N.

        A coarser surface takes them where they act, distributed to a triangle's corners: the same virtual work. On a
        finer one that would be a force on some nodes only; its nodes take the reference's traction there, which falls
        linearly from a point to its neighbours: on the same polyhedron the total is the same, to rounding. The
        reference's own points take them as they are.
        """
        if self.organ.n_surface <= self.reference.n_surface:
            return np.asarray(self.follow.T @ force)
        mine, theirs = self._areas
        return np.asarray(mine * (self.lead @ (force / theirs)))

    def displacement(self, displacement: Floats) -> Floats:
        """Return displacements (m, 3) m at the reference's points of the organ's (n, 3) m."""
        return np.asarray(self.follow @ displacement)

    def reached(self, displacement: Floats) -> Floats:
        """Return displacements (n, 3) m at the organ's points of the reference's (m, 3) m."""
        return np.asarray(self.lead @ displacement)


def sized(organ: Organ, reference: Organ) -> Sized:
    """Return an organ beside the reference, whose surface is another one of the same body or its own."""
    if organ.n_surface == reference.n_surface and np.array_equal(organ.surface_positions, reference.surface_positions):
        same = diagonal(np.ones(organ.n_surface)).tocsr()
        return Sized(organ, reference, same, same)
    return Sized(organ, reference, interpolation(organ, reference), interpolation(reference, organ))


def interpolation(source: Organ, target: Organ) -> csr_array:
    """Return the values (m, n) at the target's surface nodes of values at the source's: barycentric, nearest place."""
    triangles, points = source.surface_triangles, target.surface_positions
    chosen, weight, _ = nearest_among(source.surface_positions[triangles], points)
    return coo_array(
        (weight.ravel(), (np.repeat(np.arange(len(points)), 3), triangles[chosen].ravel())),
        shape=(len(points), source.n_surface),
    ).tocsr()


def at_size(organ: Organ, points: int) -> Organ:
    """Return the same body with another number of surface points, assembled as the pipeline does, uncalibrated.

    It has the organ's interior atoms on its own surface, and none at another size: a fit of cells has its own. A
    coarser surface is taken from the user's cache when it was made before.

    points: number of surface points.
    """
    if points == organ.n_surface:
        return reassembled(organ, organ.surface_positions, organ.surface_triangles, organ.n_interior)
    if points > organ.n_surface:
        return reassembled(organ, *divided(organ.surface_positions, organ.surface_triangles, points), 0)
    key = hashlib.sha256(f"{_VERSION} {points} {organ.digest()}".encode()).hexdigest()
    made = remembered("size", key, lambda: _resampled(organ, points))
    return reassembled(organ, made["positions"], made["triangles"], 0)


def divided(positions: Floats, triangles: Ints, points: int) -> tuple[Floats, Ints]:
    """Return the same polyhedron with more points; the points it had come first.

    Every triangle is divided into four as often as there is room, then roughly the longest edges are halved.
    """
    while 4 * len(positions) - 6 <= points:  # a point more for each of 3 n - 6 edges
        positions, faces = subdivide(positions, triangles)
        triangles = faces.astype(np.int32)
    while len(positions) < points:
        more = min(points - len(positions), max(1, int(_PASS * len(positions))))
        positions, triangles = thicken(positions, triangles, more)
    return positions, triangles


def reassembled(organ: Organ, positions: Floats, triangles: Ints, interior: int) -> Organ:
    """Return an organ of the same atoms, tissue and clamp on a surface (n, 3) m, (t, 3), with new springs."""
    return assemble_like(
        organ,
        name=f"{organ.name} of {len(positions)} points",
        surface_positions=positions,
        surface_triangles=triangles,
        fixed=held_points(organ, positions),
        interior_atoms=interior,
        provenance={"source": f"organ '{organ.name}'", "points": len(positions)},
    )


def held_points(organ: Organ, positions: Floats) -> Longs:
    """Return which points (n, 3) m of another surface of the same body are held.

    On a surface that has the organ's points and further ones: those points, and what lies on triangles all of whose
    nodes are held. On another one: where the organ's nearest point is held.
    """
    held = np.zeros(organ.n_surface, dtype=bool)
    held[organ.fixed] = True
    size = organ.n_surface
    if len(positions) < size or not np.array_equal(positions[:size], organ.surface_positions):
        return np.flatnonzero(held[cKDTree(organ.surface_positions).query(positions)[1]])
    whole = organ.surface_triangles[held[organ.surface_triangles].all(axis=1)]
    within = np.zeros(len(positions), dtype=bool)
    within[:size] = held
    if len(whole):
        near = _ON_PLANE * float(np.ptp(positions, axis=0).max())
        within |= nearest_among(organ.surface_positions[whole], positions)[2] < near
    return np.flatnonzero(within)


def _resampled(organ: Organ, points: int) -> dict[str, NDArray]:
    from tissue_sim.organ.meshes.mesh_input import SurfaceMesh, voxelize
    from tissue_sim.organ.surfaces.balloon import inflate
    from tissue_sim.organ.surfaces.surface import make_wall

    solid = voxelize(SurfaceMesh(organ.surface_positions, organ.surface_triangles, ()), organ.name)
    wall = make_wall(solid)
    balloon = inflate(wall, points)
    return {"positions": wall.to_patient(balloon.positions), "triangles": wall.outward(balloon.triangles)}
