"""Signed distances of a closed mesh on a grid, for tools that are not convex."""

from __future__ import annotations

import numpy as np
import trimesh
from scipy.spatial import cKDTree

from tissue_sim.array_types import Floats
from tissue_sim.contact.triangles import closest_points
from tissue_sim.model.data.shapes import Grid

MIN_SPACING, MAX_POINTS = 2e-4, 200_000  # m between points; points of a grid: 54 x 54 x 14 mm at 0.6 mm
_CANDIDATES = 12  # pieces among which the nearest is searched
_CHUNK = 50_000
_SAME = 1e-9  # m: distances that differ by less are equal


def distance_grid(mesh: trimesh.Trimesh, margin: float) -> Grid:
    """Return a grid of signed distances over the box of a closed mesh, as fine as its size allows.

    Parameters
    ----------
    mesh : trimesh.Trimesh
        Closed mesh, m.
    margin : float, m
        Distance by which the box is grown.
    """
    low, high = mesh.bounds[0] - margin, mesh.bounds[1] + margin
    spacing = max(MIN_SPACING, float(np.prod(high - low) / MAX_POINTS) ** (1.0 / 3.0))
    counts = np.ceil((high - low) / spacing).astype(int) + 1
    axes = [low[c] + spacing * np.arange(counts[c]) for c in range(3)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    # Triangles have similar sizes, so that the nearest one is among those with the nearest centres.
    vertices, faces = trimesh.remesh.subdivide_to_size(mesh.vertices, mesh.faces, max_edge=2.0 * spacing, max_iter=20)
    pieces = vertices[faces]
    tree = cKDTree(pieces.mean(axis=1))
    found = [_distance(pieces, tree, points[at : at + _CHUNK]) for at in range(0, len(points), _CHUNK)]
    signed = np.concatenate(found)
    # The sign changes only where the surface is nearer than a cell's diagonal: elsewhere it is that of a neighbour.
    near = np.abs(signed) <= 1.01 * np.sqrt(3.0) * spacing
    signed = _spread(signed.reshape(counts), near.reshape(counts))
    return Grid(np.ascontiguousarray(signed), low, spacing)


def distances_to(mesh: trimesh.Trimesh, points: Floats) -> Floats:
    """Return the distances of points from a mesh's surface, inside or outside.

    Parameters
    ----------
    mesh : trimesh.Trimesh
        The mesh, m.
    points : Floats, shape (p, 3), m
        The points.

    Returns
    -------
    Floats, shape (p,), m
        The distances.
    """
    usual = float(np.median(mesh.edges_unique_length))
    vertices, faces = trimesh.remesh.subdivide_to_size(mesh.vertices, mesh.faces, max_edge=2.0 * usual, max_iter=20)
    pieces = vertices[faces]
    return np.abs(_distance(pieces, cKDTree(pieces.mean(axis=1)), points))


def _distance(pieces: Floats, tree: cKDTree, points: Floats) -> Floats:
    """Return distances (p,) m of points (p, 3) to outward triangles (t, 3, 3), negative inside.

    The tree contains the triangles' centres. If several are equally near, at an edge or corner, the one whose normal is
    closest to the direction of the point determines the side.
    """
    count = min(_CANDIDATES, len(pieces))
    near = tree.query(points, k=count)[1].reshape(len(points), count)
    nearest = closest_points(pieces[near].reshape(-1, 3, 3), np.repeat(points, count, axis=0))
    way = points[:, None] - nearest.reshape(len(points), count, 3)
    apart = np.linalg.norm(way, axis=2)
    least = apart.min(axis=1)
    normal = np.cross(pieces[:, 1] - pieces[:, 0], pieces[:, 2] - pieces[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)
    height = np.einsum("pkc,pkc->pk", way, normal[near])
    height[apart > least[:, None] + _SAME] = 0.0
    seen = height[np.arange(len(points)), np.abs(height).argmax(axis=1)]
    return np.where(seen < 0.0, -least, least)


def _spread(signed: Floats, known: np.ndarray) -> Floats:
    """Return distances with signs also far from the surface: a region between known points has a single sign."""
    from scipy.ndimage import label

    regions, count = label(~known)
    if count == 0:
        return signed
    # A region's neighbours across its rim are known; the sign of any of them is the region's.
    outer = np.full(count + 1, -1.0)
    for axis in range(3):
        first, second = np.moveaxis(regions, axis, 0)[:-1], np.moveaxis(regions, axis, 0)[1:]
        values = np.moveaxis(signed, axis, 0)
        for here, there, beside in ((first, second, values[1:]), (second, first, values[:-1])):
            rim = (here > 0) & (there == 0)
            outer[here[rim]] = np.sign(beside[rim])
    outer[np.unique(np.concatenate([regions[0].ravel(), regions[-1].ravel()]))] = 1.0
    return np.where(known, signed, outer[regions] * np.abs(signed))
