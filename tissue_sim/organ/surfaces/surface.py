"""The organ's wall as a smooth level set, marching cubes on it, and measures of triangle surfaces.

Coordinates here are those of the wall's own grid: millimetres along its voxel axes from the grid's
first voxel. `Wall.to_patient` takes them to metres in the patient frame.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from skimage.measure import marching_cubes, mesh_surface_area

from tissue_sim.array_types import Floats, Ints, Mask
from tissue_sim.errors import UserError
from tissue_sim.organ.imaging.image import MM, Volume
from tissue_sim.organ.meshes.voxels import enclosed, off_grid
from tissue_sim.organ.organ import signed_volume
from tissue_sim.organ.surfaces.intersections import intersecting_pairs
from tissue_sim.organ.surfaces.solid_ball import as_ball, largest_part
from tissue_sim.organ.surfaces.surface_quality import (
    SurfaceComparison,
    SurfaceQuality,
    compare,
    corner_angles,
    measure,
)

__all__ = [
    "MarchingCubesReport",
    "SurfaceComparison",
    "SurfaceQuality",
    "Wall",
    "closed_wall",
    "compare",
    "corner_angles",
    "intersecting_pairs",
    "largest_component",
    "make_wall",
    "marching_cubes_report",
    "marching_cubes_surface",
    "measure",
    "wall_of_surface",
]


_SMOOTHING = 0.8  # voxels of the mask: takes its steps away
_SHRUNK = 0.05  # of the volume: where smoothing takes more, as it does in bodies a few voxels thick, it is made good
_SHIFTS = 2  # Newton steps of the even shift that does so: the second changes a thousandth
_MARGIN = 4  # voxels around the organ
_INNER, _OUTER = 0.1, 0.5  # voxels, level beside a cut or membrane; unequal, so that marching cubes parts diagonals


@dataclass(frozen=True, eq=False)
class Wall:
    """Signed distance to the wall on an isotropic grid: negative inside, zero on the wall.

    level (nz, ny, nx) mm; spacing mm; origin (3,) mm and direction (3, 3) as in Volume.
    fragments: separate parts of the mask left out; filled, cut: mL added to close holes, and taken away, so that the
    organ has neither cavities nor handles.
    """

    level: NDArray[np.float32]
    spacing: float
    origin: Floats
    direction: Floats
    fragments: int = 0
    filled: float = 0.0
    cut: float = 0.0

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

    Cavities are filled; handles are cut or filled with the least change (`solid_ball.as_ball`).
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
        raise UserError(f"{name} has only {volumes[largest - 1]} voxels; an organ needs more")
    if thinnest < 3:
        raise UserError(f"{name} is {thinnest} voxels thick, too thin for an organ; use a finer image")
    first = np.array([s.start for s in box[::-1]]) - _MARGIN
    h = float(spacing or mask.spacing.min())
    rough = _signed_distance(solid, mask.spacing[::-1])
    smooth = _smoothed(rough, mask.spacing[::-1])
    level = _exact_away(_resample(smooth, mask.spacing[::-1], h), h)
    solid = level < 0.0
    ball = as_ball(solid, mask.name)
    filled, cut = (float(np.count_nonzero(part)) * h**3 * 1e-3 for part in (ball & ~solid, solid & ~ball))
    return Wall(_patched(level, ball, h), h, mask.to_points(first), mask.direction, count - 1, filled, cut)


def _signed_distance(solid: Mask, sampling: Floats) -> NDArray[np.float32]:
    """Zero half-way between inner and outer voxels; exact distances between voxel centres otherwise."""
    inner = ndimage.distance_transform_edt(solid, sampling)
    outer = ndimage.distance_transform_edt(~solid, sampling)
    half = 0.5 * float(sampling.min())
    return (np.where(solid, half - inner, outer - half)).astype(np.float32)


def _smoothed(rough: NDArray[np.float32], sampling: Floats) -> NDArray[np.float32]:
    """Smooth a signed distance by a Gaussian, and keep the volume that it encloses within a twentieth.

    A Gaussian shifts a wall inward by half its variance times the wall's curvature: by 0.6 mm where a vessel has a
    radius of 5 mm and voxels are of 3 mm. Where that takes more than a twentieth of the volume, the smoothed residue is
    added, which cancels the shift to the second order (twicing, Tukey 1977), and an even shift makes good the rest.

    Parameters
    ----------
    rough : signed distance, mm, (nz, ny, nx)
    sampling : voxel spacing along each axis of the array, mm, (3,)

    Returns
    -------
    smooth signed distance, mm, (nz, ny, nx)

    """
    h = float(sampling.min())
    sigma = _SMOOTHING * h / sampling
    smooth = ndimage.gaussian_filter(rough, sigma)
    volume = float(np.count_nonzero(rough < 0.0))
    if _enclosed(smooth, h) > (1.0 - _SHRUNK) * volume:
        return smooth
    smooth += ndimage.gaussian_filter(rough - smooth, sigma)
    for _ in range(_SHIFTS):
        positions, triangles, _, _ = marching_cubes(smooth, 0.0, spacing=tuple(sampling), allow_degenerate=False)
        missing = volume * float(np.prod(sampling)) - abs(signed_volume(positions, triangles))
        smooth -= missing / mesh_surface_area(positions, triangles)
    return smooth


def _enclosed(level: NDArray[Any], h: float) -> float:
    """Return the volume inside a level set, mm, in voxels; those on the wall count by how far they lie inside."""
    return float(np.clip(0.5 - level / h, 0.0, 1.0).sum(dtype=np.float64))


def _smooth_distance(solid: Mask, h: float) -> NDArray[np.float32]:
    """Signed distance, smooth near the wall so that voxel steps don't show, exact away from it."""
    return _exact_away(_smoothed(_signed_distance(solid, np.full(3, h)), np.full(3, h)), h)


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


def _patched(level: NDArray[np.float32], ball: Mask, h: float) -> NDArray[np.float32]:
    """The level with the changed solid `ball` for its inside; its own near the wall where nothing changed.

    Cuts and membranes one voxel thin stay what they are, and parts that meet only across a diagonal stay parted:
    smoothing and marching cubes could undo both.
    """
    changed = ball != (level < 0.0)
    mixed = _diagonal(ball)
    if not (changed.any() or mixed.any()):
        return level
    patched = level.copy()
    near = mixed
    if changed.any():
        smooth = _smooth_distance(ball, h)
        own = ~ndimage.binary_dilation(changed, iterations=3) & (np.abs(smooth) < 1.5 * h)
        patched = np.where(own, level, smooth)
        near = ndimage.binary_dilation(changed, iterations=2) | mixed
    inner, outer = near & ball, near & ~ball
    patched[inner] = np.minimum(patched[inner], -_INNER * h)
    patched[outer] = np.maximum(patched[outer], _OUTER * h)
    patched[mixed & ball] = -_INNER * h
    return patched


def _diagonal(solid: Mask) -> Mask:
    """Voxels of square cells whose solid voxels are two, across the diagonal."""
    found = np.zeros_like(solid)
    for axis in range(3):
        s = np.moveaxis(solid, axis, 0)
        f = np.moveaxis(found, axis, 0)
        a, b, c, d = s[:, :-1, :-1], s[:, 1:, :-1], s[:, :-1, 1:], s[:, 1:, 1:]
        hit = (a == d) & (b == c) & (a != b)
        for j, k in ((0, 0), (1, 0), (0, 1), (1, 1)):
            f[:, j : f.shape[1] - 1 + j, k : f.shape[2] - 1 + k] |= hit
    return found


def _close(solid: Mask, radius: float) -> Mask:
    padded = np.pad(solid, int(radius) + 2)
    grown = ndimage.distance_transform_edt(~padded) <= radius
    closed = ndimage.distance_transform_edt(grown) > radius
    inner = tuple(slice(int(radius) + 2, -int(radius) - 2) for _ in range(3))
    return closed[inner] | solid


def closed_wall(wall: Wall, radius: float, smooth: bool = True) -> Wall | None:
    """The wall after a closing by a ball of `radius` mm: narrower folds are filled. None where that makes a ring.

    smooth: as smooth as the wall itself; otherwise with the voxels' steps, in a fraction of the time.
    """
    solid = wall.level < 0.0
    if radius < wall.spacing:
        return wall
    try:
        ball = as_ball(_close(solid, radius / wall.spacing), "")
    except UserError:
        return None
    if not smooth:
        return replace(wall, level=_signed_distance(ball, np.full(3, wall.spacing)))
    return replace(wall, level=_patched(wall.level, ball, wall.spacing))


def wall_of_surface(positions: Floats, triangles: Ints, wall: Wall) -> Wall:
    """The wall that a closed surface, positions (n, 3) mm and triangles outward on `wall`'s grid, makes there."""
    size = np.array(wall.level.shape[::-1], dtype=np.int64)
    solid = largest_part(enclosed(off_grid(positions / wall.spacing), triangles, size))
    if not solid.any():
        raise UserError("the surface encloses no voxel; use a finer image")
    return replace(wall, level=_smooth_distance(solid, wall.spacing))


def marching_cubes_surface(wall: Wall) -> tuple[Floats, Ints]:
    """The largest closed component of the wall by marching cubes: positions (n, 3) mm, triangles (t, 3) outward."""
    positions, triangles, _, _ = marching_cubes(wall.level, 0.0, spacing=(wall.spacing,) * 3, allow_degenerate=False)
    return largest_component(positions[:, ::-1].astype(np.float64), triangles[:, ::-1].astype(np.int32))


@dataclass(frozen=True)
class MarchingCubesReport:
    """What marching cubes gives, as the paper counts it; lengths in mm.

    points and triangles of the largest closed component; islands: other closed components that enclose
    tissue; hollows: those that enclose a cavity; fragments: both together. handles of the largest component.
    """

    points: int
    triangles: int
    islands: int
    hollows: int
    handles: int
    quality: SurfaceQuality

    @property
    def fragments(self) -> int:
        """Closed components other than the largest."""
        return self.islands + self.hollows


def marching_cubes_report(source: Wall | Volume) -> MarchingCubesReport:
    """Marching cubes (Lorensen and Cline 1987) on a wall's level set, or on a mask as segmented: counts and measures.

    Raises UserError when a mask is empty.
    """
    if isinstance(source, Wall):
        level, spacing = source.level, np.full(3, source.spacing)
    else:
        if not source.array.any():
            raise UserError(f"{source.name or 'the mask'} is empty: marching cubes finds no surface")
        level, spacing = np.pad(0.5 - source.array.astype(np.float32), 1, constant_values=0.5), source.spacing[::-1]
    found, faces, _, _ = marching_cubes(level, 0.0, spacing=tuple(spacing), allow_degenerate=False)
    everything = found[:, ::-1].astype(np.float64), faces[:, ::-1].astype(np.int32)
    _, volume = _components(*everything)
    positions, triangles = largest_component(*everything)
    quality = measure(positions, triangles)
    hollows = int(np.count_nonzero(volume < 0.0))
    return MarchingCubesReport(
        points=len(positions),
        triangles=len(triangles),
        islands=len(volume) - hollows - 1,
        hollows=hollows,
        handles=1 - quality.euler // 2,
        quality=quality,
    )


def _components(positions: Floats, triangles: Ints) -> tuple[Ints, Floats]:
    """Component of every point, (n,), and the signed volume that each encloses."""
    n = len(positions)
    links = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]]])
    graph = coo_matrix((np.ones(len(links)), (links[:, 0], links[:, 1])), shape=(n, n))
    _, label = connected_components(graph, directed=False)
    a, b, c = (positions[triangles[:, k]] for k in range(3))
    signed = np.einsum("ij,ij->i", a, np.cross(b, c)) / 6.0
    return label, np.bincount(label[triangles[:, 0]], weights=signed)


def largest_component(positions: Floats, triangles: Ints) -> tuple[Floats, Ints]:
    """The component with the largest enclosed volume, wound outward; points in no triangle are dropped."""
    label, volume = _components(positions, triangles)
    chosen = int(np.abs(volume).argmax())
    triangles = triangles[label[triangles[:, 0]] == chosen]
    if volume[chosen] < 0.0:
        triangles = triangles[:, ::-1]
    used, inverse = np.unique(triangles, return_inverse=True)
    return positions[used], inverse.reshape(-1, 3).astype(np.int32)
