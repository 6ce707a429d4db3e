"""One body at several point counts, and what carries loads and displacements between their surfaces.

The body is the solid inside one organ's surface. Coarser and finer surfaces of it come out of the pipeline: voxels,
wall, balloon. They keep the organ's atoms, tissue and clamp.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array, eye_array
from scipy.spatial import cKDTree

from tissue_sim.array_types import Floats
from tissue_sim.contact.triangles import nearest_weights
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.topology import assemble_like, node_area
from tissue_sim.store import remembered

_CANDIDATES = 16  # triangles with the nearest middles, among which the nearest one is looked for
_VERSION = "1"  # of what is remembered


@dataclass(frozen=True, eq=False)
class Sized:
    """A body at one point count: its organ (n points) and how it stands to the reference's surface (m points).

    follow (m, n): displacements of the reference's points, each of which follows the nearest place on the organ's
    surface; lead (n, m): the same the other way about.
    """

    organ: Organ
    reference: Organ
    follow: csr_array
    lead: csr_array

    def forces(self, force: Floats) -> Floats:
        """Forces (n, 3) N of the reference's forces (m, 3) N.

        A coarser surface takes them where they act, shared by a triangle's corners: the same virtual work. On a
        finer one that would be a force on some nodes only; its nodes take the reference's traction there, in all the
        same force. The reference's own points take them as they are.
        """
        if self.organ.n_surface <= self.reference.n_surface:
            return np.asarray(self.follow.T @ force)
        mine, theirs = (node_area(one.surface_positions, one.surface_triangles) for one in (self.organ, self.reference))
        found = mine[:, None] * (self.lead @ (force / theirs[:, None]))
        found[self.organ.fixed] = 0.0
        size, wanted = np.abs(found).sum(axis=0), np.abs(force).sum(axis=0)
        return np.asarray(found * np.divide(wanted, size, out=np.zeros(3), where=size > 0.0))

    def displacement(self, displacement: Floats) -> Floats:
        """Displacements (m, 3) m at the reference's points of the organ's (n, 3) m."""
        return np.asarray(self.follow @ displacement)

    def reached(self, displacement: Floats) -> Floats:
        """Displacements (n, 3) m at the organ's points of the reference's (m, 3) m."""
        return np.asarray(self.lead @ displacement)


def sized(organ: Organ, reference: Organ) -> Sized:
    """An organ beside the reference, whose surface is another one of the same body or its own."""
    if organ.n_surface == reference.n_surface and np.array_equal(organ.surface_positions, reference.surface_positions):
        same = csr_array(eye_array(organ.n_surface))
        return Sized(organ, reference, same, same)
    return Sized(organ, reference, interpolation(organ, reference), interpolation(reference, organ))


def interpolation(source: Organ, target: Organ) -> csr_array:
    """Values at the target's surface nodes of values at the source's, (m, n): barycentric at the nearest place."""
    triangles, points = source.surface_triangles, target.surface_positions
    corner = source.surface_positions[triangles]
    count = min(_CANDIDATES, len(triangles))
    near = cKDTree(corner.mean(axis=1)).query(points, k=count)[1].reshape(len(points), count)
    weights, distance = nearest_weights(corner[near].reshape(-1, 3, 3), np.repeat(points, count, axis=0))
    rows = np.arange(len(points))
    best = distance.reshape(len(points), count).argmin(axis=1)
    chosen = near[rows, best]
    weight = weights.reshape(len(points), count, 3)[rows, best]
    return coo_array(
        (weight.ravel(), (np.repeat(rows, 3), triangles[chosen].ravel())),
        shape=(target.n_surface, source.n_surface),
    ).tocsr()


def at_size(organ: Organ, points: int) -> Organ:
    """The same body with this many surface points, assembled as the pipeline does, uncalibrated.

    The organ's own surface at its own number of points. Found in the user's cache when it was made before.
    """
    if points == organ.n_surface:
        return assembled_anew(organ, organ.surface_positions, organ.surface_triangles)
    key = hashlib.sha256(f"{_VERSION} {points} {organ.digest()}".encode()).hexdigest()
    made = remembered("size", key, lambda: _resampled(organ, points))
    return assembled_anew(organ, made["positions"], made["triangles"])


def assembled_anew(organ: Organ, positions: Floats, triangles: NDArray[np.int32], interior: int | None = None) -> Organ:
    """An organ of the same atoms, tissue and clamp on a surface (n, 3) m, (t, 3), with the pipeline's springs.

    interior: its interior atoms, by default as many for each surface point as the organ has. A point is held where
    the organ's nearest one is.
    """
    held = np.zeros(organ.n_surface, dtype=bool)
    held[organ.fixed] = True
    if interior is None:
        interior = round(organ.n_interior * len(positions) / organ.n_surface)
    return assemble_like(
        organ,
        name=f"{organ.name} of {len(positions)} points",
        surface_positions=positions,
        surface_triangles=triangles,
        fixed=np.flatnonzero(held[cKDTree(organ.surface_positions).query(positions)[1]]),
        interior_atoms=interior,
        provenance={"source": f"organ '{organ.name}'", "points": len(positions)},
    )


def _resampled(organ: Organ, points: int) -> dict[str, NDArray]:
    from tissue_sim.organ.meshes.mesh_input import SurfaceMesh, voxelize
    from tissue_sim.organ.surfaces.balloon import inflate
    from tissue_sim.organ.surfaces.surface import make_wall

    solid = voxelize(SurfaceMesh(organ.surface_positions, organ.surface_triangles, ()), organ.name)
    wall = make_wall(solid)
    balloon = inflate(wall, points)
    return {"positions": wall.to_patient(balloon.positions), "triangles": wall.outward(balloon.triangles)}
