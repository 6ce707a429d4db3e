"""The organ's wall as a smooth level set, marching cubes on it, and measures of triangle surfaces.

Coordinates here are those of the wall's own grid: millimetres along its voxel axes from the grid's
first voxel. `Wall.to_patient` takes them to metres in the patient frame.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree
from skimage.measure import euler_number, marching_cubes

from tissue_sim.errors import UserError
from tissue_sim.organ.image import MM, Volume
from tissue_sim.organ.voxels import enclosed, off_grid

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]
Mask = NDArray[np.bool_]

_SMOOTHING = 0.8  # voxels of the mask: takes its steps away, shifts a wall of radius 20 mm by under 0.1 mm
_MARGIN = 4  # voxels around the organ
_LARGEST_CLOSING = 0.75  # depths of the organ
_FILLINGS_TRIED = 20


@dataclass(frozen=True, eq=False)
class Wall:
    """Signed distance to the wall on an isotropic grid: negative inside, zero on the wall.

    level (nz, ny, nx) mm; spacing mm; origin (3,) mm and direction (3, 3) as in Volume.
    fragments: separate parts of the mask left out; filled: mL added to close holes and handles.
    """

    level: NDArray[np.float32]
    spacing: float
    origin: Floats
    direction: Floats
    fragments: int = 0
    filled: float = 0.0

    def sample(self, points: ArrayLike) -> Floats:
        """Signed distance (n,) mm at points (n, 3) mm."""
        index = np.asarray(points, dtype=np.float64).T[::-1] / self.spacing
        return ndimage.map_coordinates(self.level, index, output=np.float64, order=1, mode="nearest")

    def gradient(self, points: ArrayLike) -> Floats:
        """Gradient (n, 3) of the signed distance at points (n, 3) mm, by central differences over a voxel."""
        p = np.asarray(points, dtype=np.float64)
        step = 0.5 * self.spacing * np.eye(3)
        return np.stack([self.sample(p + e) - self.sample(p - e) for e in step], axis=1) / self.spacing

    def project(self, points: Floats, steps: int = 4) -> Floats:
        """Move points (n, 3) mm near the wall onto it, along the gradient, by damped Newton steps."""
        p = points.copy()
        for _ in range(steps):
            gradient = self.gradient(p)
            slope = np.maximum(np.einsum("ij,ij->i", gradient, gradient), 0.05)
            move = gradient * (self.sample(p) / slope)[:, None]
            length = np.linalg.norm(move, axis=1, keepdims=True)
            p -= move * np.minimum(1.0, self.spacing / np.maximum(length, 1e-12))
        return p

    def points(self) -> Floats:
        """Points (n, 3) mm of the wall: where it crosses the lines between neighbouring voxel centres."""
        found = []
        for axis in range(3):
            level = np.moveaxis(self.level, axis, 0)
            low, high = level[:-1], level[1:]
            index = np.argwhere((low < 0.0) != (high < 0.0))
            a, b = (part[tuple(index.T)].astype(np.float64) for part in (low, high))
            where = index.astype(np.float64)
            where[:, 0] += a / (a - b)
            found.append(np.insert(where[:, 1:], axis, where[:, 0], axis=1))
        return np.concatenate(found)[:, ::-1] * self.spacing

    def area(self) -> float:
        """Area of the wall, mm^2, from the gradient of its smoothed indicator."""
        inside = np.clip(0.5 - self.level / (2.0 * self.spacing), 0.0, 1.0)
        steep = np.sqrt(sum(np.gradient(inside, axis=axis) ** 2 for axis in range(3)))
        return float(steep.sum(dtype=np.float64)) * self.spacing**2

    def to_patient(self, points: ArrayLike) -> Floats:
        """Points (n, 3) mm of the grid as metres in the patient frame."""
        return (self.origin + np.asarray(points, dtype=np.float64) @ self.direction.T) * MM

    def outward(self, triangles: Ints) -> Ints:
        """Triangles (t, 3), outward on the grid, so that they are outward in the patient frame."""
        return triangles if np.linalg.det(self.direction) > 0.0 else np.ascontiguousarray(triangles[:, ::-1])


def make_wall(mask: Volume, spacing: float | None = None) -> Wall:
    """The smooth wall of a mask's largest part, without cavities or handles (a topological ball).

    Cavities are filled; handles are closed by a closing of growing radius, up to three quarters of the organ's depth.
    spacing: of the isotropic grid, mm; None: the mask's finest.
    Raises UserError when the mask is empty, a few voxels only, or keeps its handles.
    """
    labels, count = ndimage.label(mask.array, structure=np.ones((3, 3, 3)))
    if count == 0:
        raise UserError(f"{mask.name or 'the mask'} is empty: there is no organ to build")
    volumes = np.bincount(labels.ravel())[1:]
    largest = int(volumes.argmax()) + 1
    box = ndimage.find_objects(labels)[largest - 1]
    solid = np.pad(labels[box] == largest, _MARGIN)
    name = mask.name or "the mask"
    thinnest = min(s.stop - s.start for s in box)
    if volumes[largest - 1] < 50:
        raise UserError(f"{name} holds {volumes[largest - 1]} voxels only; an organ needs more")
    if thinnest < 3:
        raise UserError(f"{name} is {thinnest} voxels thick, too thin for an organ; use a finer image")
    first = np.array([s.start for s in box[::-1]]) - _MARGIN
    h = float(spacing or mask.spacing.min())
    rough = _signed_distance(solid, mask.spacing[::-1])
    smooth = ndimage.gaussian_filter(rough, _SMOOTHING * mask.spacing.min() / mask.spacing[::-1])
    level = _exact_away(_resample(smooth, mask.spacing[::-1], h), h)
    ball, filled = _as_ball(level < 0.0, h, mask.name)
    return Wall(_patched(level, ball, h), h, mask.to_points(first), mask.direction, count - 1, filled)


def _signed_distance(solid: Mask, sampling: Floats) -> NDArray[np.float32]:
    """Zero half-way between inner and outer voxels; exact distances between voxel centres otherwise."""
    inner = ndimage.distance_transform_edt(solid, sampling)
    outer = ndimage.distance_transform_edt(~solid, sampling)
    half = 0.5 * float(sampling.min())
    return (np.where(solid, half - inner, outer - half)).astype(np.float32)


def _smooth_distance(solid: Mask, h: float) -> NDArray[np.float32]:
    """Signed distance, smooth near the wall so that voxel steps don't show, exact away from it."""
    return _exact_away(ndimage.gaussian_filter(_signed_distance(solid, np.full(3, h)), _SMOOTHING), h)


def _exact_away(smooth: NDArray[np.float32], h: float) -> NDArray[np.float32]:
    """Exact distances to the smooth level's inside from 2.5 voxels on: smoothing alone flattens the ridges."""
    exact = _signed_distance(smooth < 0.0, np.full(3, h))
    share = np.clip(np.abs(exact) / h - 1.5, 0.0, 1.0)
    return (smooth + share * (exact - smooth)).astype(np.float32)


def _resample(level: NDArray[np.float32], sampling: Floats, h: float) -> NDArray[np.float32]:
    if np.allclose(sampling, h, rtol=1e-3):
        return level
    shape = [int(np.floor((n - 1) * s / h)) + 1 for n, s in zip(level.shape, sampling, strict=True)]
    axes = [np.arange(n) * h / s for n, s in zip(shape, sampling, strict=True)]
    grid = np.meshgrid(*axes, indexing="ij")
    return ndimage.map_coordinates(level, grid, output=np.float32, order=3, mode="nearest")


def _as_ball(solid: Mask, h: float, name: str) -> tuple[Mask, float]:
    """Fill cavities and close handles until the solid is a topological ball (Euler number 1); and the mL added."""
    ball = _largest_part(ndimage.binary_fill_holes(solid))
    start, radius, limit = ball, 0.0, 0.0
    while euler_number(ball, connectivity=1) != 1:
        limit = limit or _LARGEST_CLOSING * float(ndimage.distance_transform_edt(start).max())
        radius = max(1.3 * radius, radius + 1.0)
        if radius > limit:
            raise UserError(
                f"{name or 'the mask'} has a hole through it (like a ring) that can't be closed;"
                " the balloon needs a solid without one"
            )
        ball = _largest_part(ndimage.binary_fill_holes(_close(start, radius)))
    ball = _without_needless(ball, start) if radius > 0.0 else ball
    return ball, float(np.count_nonzero(ball & ~solid)) * h**3 * 1e-3


def _without_needless(ball: Mask, start: Mask) -> Mask:
    """Take back, largest first, the fillings of the closing that weren't needed to close a handle."""
    labels, _ = ndimage.label(ball & ~start)
    order = np.argsort(np.bincount(labels.ravel())[1:])[::-1][:_FILLINGS_TRIED]
    for part in order + 1:
        less = ball & (labels != part)
        if euler_number(less, connectivity=1) == 1 and ndimage.label(less)[1] == 1:
            ball = less
    return ball


def _patched(level: NDArray[np.float32], ball: Mask, h: float) -> NDArray[np.float32]:
    """The level with the changed solid `ball` for its inside; its own near the wall where nothing changed."""
    changed = ball != (level < 0.0)
    if not changed.any():
        return level
    smooth = _smooth_distance(ball, h)
    own = ~ndimage.binary_dilation(changed, iterations=3) & (np.abs(smooth) < 1.5 * h)
    return np.where(own, level, smooth)


def _largest_part(solid: Mask) -> Mask:
    labels, count = ndimage.label(solid)
    return labels == int(np.bincount(labels.ravel())[1:].argmax()) + 1 if count > 1 else solid


def _close(solid: Mask, radius: float) -> Mask:
    padded = np.pad(solid, int(radius) + 2)
    grown = ndimage.distance_transform_edt(~padded) <= radius
    closed = ndimage.distance_transform_edt(grown) > radius
    inner = tuple(slice(int(radius) + 2, -int(radius) - 2) for _ in range(3))
    return closed[inner] | solid


def closed_wall(wall: Wall, radius: float) -> Wall | None:
    """The wall after a closing by a ball of `radius` mm: narrower folds are filled. None where that makes a ring."""
    solid = wall.level < 0.0
    if radius < wall.spacing:
        return wall
    try:
        ball = _as_ball(_close(solid, radius / wall.spacing), wall.spacing, "")[0]
    except UserError:
        return None
    return replace(wall, level=_patched(wall.level, ball, wall.spacing))


def wall_of_surface(positions: Floats, triangles: Ints, wall: Wall) -> Wall:
    """The wall that a closed surface, positions (n, 3) mm and triangles outward on `wall`'s grid, makes there."""
    size = np.array(wall.level.shape[::-1], dtype=np.int64)
    solid = _largest_part(enclosed(off_grid(positions / wall.spacing), triangles, size))
    if not solid.any():
        raise UserError("the surface encloses no voxel; use a finer image")
    return replace(wall, level=_smooth_distance(solid, wall.spacing))


def marching_cubes_surface(wall: Wall) -> tuple[Floats, Ints]:
    """The largest closed component of the wall by marching cubes: positions (n, 3) mm, triangles (t, 3) outward."""
    positions, triangles, _, _ = marching_cubes(wall.level, 0.0, spacing=(wall.spacing,) * 3, allow_degenerate=False)
    return largest_component(positions[:, ::-1].astype(np.float64), triangles[:, ::-1].astype(np.int32))


def largest_component(positions: Floats, triangles: Ints) -> tuple[Floats, Ints]:
    """The component with the largest enclosed volume, wound outward; points in no triangle are dropped."""
    n = len(positions)
    links = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]]])
    graph = coo_matrix((np.ones(len(links)), (links[:, 0], links[:, 1])), shape=(n, n))
    _, label = connected_components(graph, directed=False)
    a, b, c = (positions[triangles[:, k]] for k in range(3))
    volume = np.bincount(label[triangles[:, 0]], weights=np.einsum("ij,ij->i", a, np.cross(b, c)) / 6.0)
    chosen = int(np.abs(volume).argmax())
    triangles = triangles[label[triangles[:, 0]] == chosen]
    if volume[chosen] < 0.0:
        triangles = triangles[:, ::-1]
    used, inverse = np.unique(triangles, return_inverse=True)
    return positions[used], inverse.reshape(-1, 3).astype(np.int32)


@dataclass(frozen=True)
class SurfaceQuality:
    """Measures of a closed triangle surface; lengths in the unit of its positions."""

    euler: int  # 2 for genus 0
    open_edges: int
    edge_mean: float
    edge_variation: float  # standard deviation over mean
    least_angle: float  # degrees
    volume: float
    self_intersections: int  # pairs of triangles


def measure(positions: Floats, triangles: Ints) -> SurfaceQuality:
    """Measures of the surface positions (n, 3), triangles (t, 3)."""
    edges = np.sort(np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]), axis=1)
    unique, count = np.unique(edges, axis=0, return_counts=True)
    length = np.linalg.norm(positions[unique[:, 0]] - positions[unique[:, 1]], axis=1)
    a, b, c = (positions[triangles[:, k]] for k in range(3))
    return SurfaceQuality(
        euler=len(np.unique(triangles)) - len(unique) + len(triangles),
        open_edges=int(np.count_nonzero(count != 2)),
        edge_mean=float(length.mean()),
        edge_variation=float(length.std() / length.mean()),
        least_angle=float(np.rad2deg(corner_angles(positions, triangles).min())),
        volume=float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0),
        self_intersections=len(intersecting_pairs(positions, triangles)),
    )


def corner_angles(positions: Floats, triangles: Ints) -> Floats:
    """The three angles of every triangle, (t, 3) rad."""
    corner = positions[triangles]
    u = np.roll(corner, -1, axis=1) - corner
    v = np.roll(corner, -2, axis=1) - corner
    return np.arctan2(np.linalg.norm(np.cross(u, v), axis=2), np.einsum("ijk,ijk->ij", u, v))


def intersecting_pairs(positions: Floats, triangles: Ints) -> Ints:
    """Pairs (k, 2) of triangles without a common point of which an edge of one runs through the other."""
    corner = positions[triangles]
    centre = corner.mean(axis=1)
    radius = np.linalg.norm(corner - centre[:, None], axis=2).max(axis=1)
    pairs = cKDTree(centre).query_pairs(2.0 * radius.max(), output_type="ndarray")
    first, second = pairs.T
    pairs = pairs[np.linalg.norm(centre[first] - centre[second], axis=1) <= radius[first] + radius[second]]
    shared = (triangles[pairs[:, 0]][:, :, None] == triangles[pairs[:, 1]][:, None, :]).any(axis=(1, 2))
    pairs = pairs[~shared]
    hit = np.zeros(len(pairs), dtype=bool)
    for one, other in ((0, 1), (1, 0)):
        for k in range(3):
            start, end = corner[pairs[:, one], k], corner[pairs[:, one], (k + 1) % 3]
            hit |= _segment_hits(start, end, corner[pairs[:, other]])
    return pairs[hit].astype(np.int32)


def _segment_hits(start: Floats, end: Floats, triangle: Floats) -> Mask:
    """Moeller-Trumbore, vectorized: does the segment start-end run through the triangle?"""
    a, u, v = triangle[:, 0], triangle[:, 1] - triangle[:, 0], triangle[:, 2] - triangle[:, 0]
    d = end - start
    p = np.cross(d, v)
    det = np.einsum("ij,ij->i", u, p)
    safe = np.where(np.abs(det) > 1e-18, det, 1.0)
    s = start - a
    q = np.cross(s, u)
    alpha, beta = np.einsum("ij,ij->i", s, p) / safe, np.einsum("ij,ij->i", d, q) / safe
    t = np.einsum("ij,ij->i", v, q) / safe
    inside = (alpha >= 0.0) & (beta >= 0.0) & (alpha + beta <= 1.0)
    return (np.abs(det) > 1e-18) & inside & (t >= 0.0) & (t <= 1.0)
