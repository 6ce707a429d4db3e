"""Centreline by distance mapping (Wan & Liang 2002), and medial atoms spaced evenly along it.

Every inner voxel knows its exact distance from the boundary (DFB). A tree grows from the voxel of largest
DFB over the 26-neighbour graph, always on to the reachable voxel of largest DFB, keeping each voxel's
parent. The tips are the two inner voxels farthest from each other, as the way inside goes; the tree's
path between them is the centreline: it stays in the middle because the tree prefers large DFB. It is then
trimmed at the tips, centred between voxels, smoothed and resampled by arc length.
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.interpolate import make_smoothing_spline
from scipy.ndimage import distance_transform_edt, gaussian_filter, map_coordinates
from scipy.spatial import cKDTree

from tissue_sim.errors import UserError
from tissue_sim.organ.surface import Wall

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

_GROWTH = 0.4  # the centreline starts where its radius grows by less than this per length: 1 on a tip's own axis
_THINNEST = 0.35  # and where the radius is this share of the side's median
_LONGEST_TRIM = 0.75  # share of either side that may be trimmed: a ball keeps a short centreline
_CENTRING_STEPS = 30


@dataclass(frozen=True, eq=False)
class Skeleton:
    """Medial atoms as a chain.

    positions (a, 3) mm on the wall's grid; radius (a,) mm: distance to the wall; parent (a,): the neighbour
    towards the root, -1 at the root, else i - 1; length mm: of the centreline.
    """

    positions: Floats
    radius: Floats
    parent: Ints
    length: float


def check_atoms(atoms: int) -> None:
    """Raise UserError for fewer than 1 atom."""
    if atoms < 1:
        raise UserError(f"--atoms {atoms} is too few; use 1 or more")


def extract(wall: Wall, atoms: int) -> Skeleton:
    """Chain of `atoms` medial atoms, evenly spaced by arc length, inside the wall.

    Raises UserError for fewer than 1 atom, or an organ too small for its grid.
    """
    check_atoms(atoms)
    inside = wall.level < 0.0
    depth = distance_transform_edt(inside) - 0.5
    if depth.max() < 1.5:
        raise UserError("the organ is under four voxels thick, too thin for a skeleton; use a finer image")
    path = centreline(depth) * wall.spacing
    field = gaussian_filter(np.where(inside, depth, 0.0), 0.7).astype(np.float32) * np.float32(wall.spacing)
    path = _trim(path, _sample(field, path, wall.spacing))
    line = _smooth(_centre(_smooth(path, field, wall.spacing), field, wall.spacing), field, wall.spacing)
    positions = _resample(line, atoms) if atoms > 1 else path[[int(_sample(field, path, wall.spacing).argmax())]]
    if np.any(wall.sample(positions) >= 0.0):
        raise UserError("the skeleton leaves the organ; use a finer image or a smoother mask")
    radius, _ = cKDTree(wall.points()).query(positions)
    length = float(np.linalg.norm(np.diff(line, axis=0), axis=1).sum())
    return Skeleton(positions, radius, np.arange(-1, atoms - 1, dtype=np.int32), length)


def centreline(depth: NDArray[np.float64]) -> Floats:
    """Path through the distance-mapping tree between the two tips of depth (nz, ny, nx) voxels, positive inside.

    Returns voxel coordinates (m, 3) in order x, y, z, from one tip to the other.
    """
    shape = depth.shape
    parent, order = grow_tree(np.ascontiguousarray(depth, dtype=np.float64).ravel(), np.array(shape))
    reached = order[order >= 0]
    sizes = np.array(shape)
    first = int(reached[farthest(parent, sizes, int(order[0]))[reached].argmax()])
    other = int(reached[farthest(parent, sizes, first)[reached].argmax()])
    side, branch = _path(parent, first), _path(parent, other)
    while len(side) > 1 and len(branch) > 1 and side[-2] == branch[-2]:
        side.pop()
        branch.pop()
    chain = side + branch[-2::-1]
    return np.stack(np.unravel_index(chain, shape), axis=1)[:, ::-1].astype(np.float64)


@njit(cache=True)
def grow_tree(depth: Floats, shape: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Prim-like growth from the deepest voxel over the 26-neighbour graph, deepest reachable voxel first.

    depth: flattened (nz ny nx,), positive inside; the outermost layer of voxels must be outside.
    Returns parent (-1 at the root, -2 where not reached) and the order of growth (filled with -1 behind
    the last voxel).
    """
    nz, ny, nx = shape[0], shape[1], shape[2]
    parent = np.full(depth.size, -2, dtype=np.int64)
    order = np.full(depth.size, -1, dtype=np.int64)
    root = np.argmax(depth)
    parent[root] = -1
    heap = [(-depth[root], root)]
    grown = 0
    while len(heap) > 0:
        _, v = heapq.heappop(heap)
        order[grown] = v
        grown += 1
        z, y, x = v // (ny * nx), (v // nx) % ny, v % nx
        for dz in range(-1, 2):
            for dy in range(-1, 2):
                for dx in range(-1, 2):
                    k, j, i = z + dz, y + dy, x + dx
                    if k < 0 or j < 0 or i < 0 or k >= nz or j >= ny or i >= nx:
                        continue
                    w = (k * ny + j) * nx + i
                    if parent[w] == -2 and depth[w] > 0.0:
                        parent[w] = v
                        heapq.heappush(heap, (-depth[w], w))
    return parent, order


def _path(parent: NDArray[np.int64], tip: int) -> list[int]:
    """Voxels from the tip to the root."""
    path = [tip]
    while parent[path[-1]] >= 0:
        path.append(int(parent[path[-1]]))
    return path


@njit(cache=True)
def farthest(parent: NDArray[np.int64], shape: NDArray[np.int64], source: int) -> Floats:
    """Length of the shortest way from `source`, in voxels, over the reached voxels (parent > -2); -1 elsewhere."""
    nz, ny, nx = shape[0], shape[1], shape[2]
    distance = np.full(parent.size, -1.0)
    best = np.full(parent.size, np.inf)
    best[source] = 0.0
    heap = [(0.0, source)]
    while len(heap) > 0:
        d, v = heapq.heappop(heap)
        if distance[v] >= 0.0:
            continue
        distance[v] = d
        z, y, x = v // (ny * nx), (v // nx) % ny, v % nx
        for dz in range(-1, 2):
            for dy in range(-1, 2):
                for dx in range(-1, 2):
                    k, j, i = z + dz, y + dy, x + dx
                    if k < 0 or j < 0 or i < 0 or k >= nz or j >= ny or i >= nx:
                        continue
                    w = (k * ny + j) * nx + i
                    if parent[w] > -2 and distance[w] < 0.0:
                        there = d + np.sqrt(float(dx * dx + dy * dy + dz * dz))
                        if there < best[w]:
                            best[w] = there
                            heapq.heappush(heap, (there, w))
    return distance


def _sample(field: NDArray[np.float32], points: Floats, h: float) -> Floats:
    return map_coordinates(field, points.T[::-1] / h, output=np.float64, order=1, mode="nearest")


def _arc(points: Floats) -> Floats:
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])


def _trim(path: Floats, radius: Floats) -> Floats:
    """Cut both tips back to where the path runs along the organ, not from a corner of its tip to the middle."""
    root = int(radius.argmax())
    first = _inner_end(path[: root + 1], radius[: root + 1])
    last = _inner_end(path[root:][::-1], radius[root:][::-1])
    return path[first : len(path) - last]


def _inner_end(side: Floats, radius: Floats) -> int:
    """First point of a side, from its tip, that is thick enough and from which the radius grows slowly."""
    arc = _arc(side)
    ahead = arc + np.maximum(0.5 * radius, arc[-1] / max(len(arc), 2))
    growth = (np.interp(ahead, arc, radius) - radius) / (ahead - arc)
    fit = (growth < _GROWTH) & (radius >= _THINNEST * np.median(radius))
    return int(np.flatnonzero(fit | (arc > _LONGEST_TRIM * arc[-1]))[0]) if arc[-1] > 0.0 else 0


def _smooth(path: Floats, field: NDArray[np.float32], h: float) -> Floats:
    """Smoothing spline along the path; stiffer for a thick organ, softer where that would leave it."""
    if len(path) < 8:
        return path
    arc = _arc(path)
    keep = np.concatenate([[True], np.diff(arc) > 1e-9])
    arc, path = arc[keep], path[keep]
    scale = max(float(np.median(_sample(field, path, h))), 2.0 * h)
    t = np.linspace(0.0, arc[-1], max(int(2.0 * arc[-1] / h), 16))
    even = np.stack([np.interp(t, arc, path[:, k]) for k in range(3)], axis=1)
    least = 0.9 * min(float(_sample(field, even, h).min()), h)
    for share in (0.35, 0.2, 0.1, 0.05):
        stiffness = (share * scale) ** 4 / (t[1] - t[0])
        line = np.stack([make_smoothing_spline(t, even[:, k], lam=stiffness)(t) for k in range(3)], axis=1)
        if np.all(_sample(field, line, h) > least):
            return line
    return even


def _centre(line: Floats, field: NDArray[np.float32], h: float) -> Floats:
    """Move the line across its direction towards larger distance, by steps of a tenth of a voxel."""
    line = line.copy()
    step = 0.5 * h * np.eye(3)
    for _ in range(_CENTRING_STEPS):
        tangent = np.gradient(line, axis=0)
        tangent /= np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-12)
        slope = np.stack([_sample(field, line + e, h) - _sample(field, line - e, h) for e in step], axis=1) / h
        slope -= tangent * np.einsum("ij,ij->i", slope, tangent)[:, None]
        line += 0.1 * h * slope
    return line


def _resample(line: Floats, count: int) -> Floats:
    """`count` points evenly spaced by arc length along the line, its ends included."""
    arc = _arc(line)
    even = np.linspace(0.0, arc[-1], count)
    return np.stack([np.interp(even, arc, line[:, k]) for k in range(3)], axis=1)
