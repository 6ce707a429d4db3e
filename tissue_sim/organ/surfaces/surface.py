"""Smooth level set of an organ's wall, marching cubes on it, and measures of triangle surfaces.

Coordinates here are those of the wall's own grid: millimetres along its voxel axes from the grid's first voxel.
`Wall.to_patient` converts them to metres in the patient frame.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage
from skimage.measure import marching_cubes, mesh_surface_area

from tissue_sim.array_types import Array, Floats, Ints, Mask
from tissue_sim.errors import UserError
from tissue_sim.organ.imaging.image import MM, Volume
from tissue_sim.organ.meshes.voxels import enclosed, off_grid
from tissue_sim.organ.surface_checks import signed_volume
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
    "SurfaceComparison",
    "SurfaceQuality",
    "Wall",
    "closed_wall",
    "compare",
    "corner_angles",
    "intersecting_pairs",
    "make_wall",
    "measure",
    "wall_of_surface",
]
_SMOOTHING = 0.8  # voxels of the mask: takes its steps away
_SHRUNK = 0.05  # of the volume: where smoothing takes more, as it does in bodies a few voxels thick, it is corrected
_SHIFTS = 2  # Newton steps of the even shift that does so: the second changes a thousandth
_MARGIN = 4  # voxels around the organ
_INNER, _OUTER = 0.1, 0.5  # voxels, level beside a cut or membrane; unequal, so that marching cubes parts diagonals


@dataclass(frozen=True, eq=False)
class Wall:
    """Signed distance to the wall on an isotropic grid: negative inside, zero on the wall.

    Attributes
    ----------
    level : NDArray[np.float32], shape (nz, ny, nx), mm
        Signed distance.
    spacing : float, mm
        Spacing of the grid.
    origin : Floats, shape (3,), mm
        Centre of the first voxel, as in Volume.
    direction : Floats, shape (3, 3)
        Columns are the voxel axes, as in Volume.
    fragments : int
        Number of separate parts of the mask that were left out.
    filled : float, mL
        Volume added, so that the organ has neither cavities nor handles.
    cut : float, mL
        Volume removed for the same purpose.
    """

    level: NDArray[np.float32]
    spacing: float
    origin: Floats
    direction: Floats
    fragments: int = 0
    filled: float = 0.0
    cut: float = 0.0

    def sample(self, points: ArrayLike) -> Floats:
        """Return the signed distance (n,), mm.

        Parameters
        ----------
        points : ArrayLike, shape (n, 3), mm
            The points.
        """
        index = np.asarray(points, dtype=np.float64).T[::-1] / self.spacing
        return ndimage.map_coordinates(self.level, index, output=np.float64, order=1, mode="nearest")

    def gradient(self, points: ArrayLike) -> Floats:
        """Return the gradient (n, 3) of the signed distance, by central differences.

        Parameters
        ----------
        points : ArrayLike, shape (n, 3), mm
            The points.
        """
        p = np.asarray(points, dtype=np.float64)
        step = 0.5 * self.spacing * np.eye(3)
        return np.stack([self.sample(p + e) - self.sample(p - e) for e in step], axis=1) / self.spacing

    def project(self, points: Floats, steps: int = 4) -> Floats:
        """Move points near the wall onto it, along the gradient, by damped Newton steps.

        Parameters
        ----------
        points : Floats, shape (n, 3), mm
            The points.
        steps : int, optional
            Number of the steps.
        """
        p = points.copy()
        for _ in range(steps):
            gradient = self.gradient(p)
            slope = np.maximum(np.einsum("ij,ij->i", gradient, gradient), 0.05)
            move = gradient * (self.sample(p) / slope)[:, None]
            length = np.linalg.norm(move, axis=1, keepdims=True)
            p -= move * np.minimum(1.0, self.spacing / np.maximum(length, 1e-12))
        return p

    def points(self) -> Floats:
        """Return the points (n, 3) mm where the wall crosses the lines between neighbouring voxel centres."""
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
        """Return the area of the wall, mm^2, from the gradient of its smoothed indicator."""
        inside = np.clip(0.5 - self.level / (2.0 * self.spacing), 0.0, 1.0)
        steep = np.sqrt(sum(np.gradient(inside, axis=axis) ** 2 for axis in range(3)))
        return float(steep.sum(dtype=np.float64)) * self.spacing**2

    def to_patient(self, points: ArrayLike) -> Floats:
        """Return points of the grid in the patient frame, (n, 3), m.

        Parameters
        ----------
        points : ArrayLike, shape (n, 3), mm
            The points.
        """
        return (self.origin + np.asarray(points, dtype=np.float64) @ self.direction.T) * MM

    def outward(self, triangles: Ints) -> Ints:
        """Return triangles, outward on the grid, so that they are outward in the patient frame.

        Parameters
        ----------
        triangles : Ints, shape (t, 3)
            Corner indices.
        """
        return triangles if np.linalg.det(self.direction) > 0.0 else np.ascontiguousarray(triangles[:, ::-1])


def make_wall(mask: Volume) -> Wall:
    """Return the smooth wall of a mask's largest part, without cavities or handles (a topological ball).

    Cavities are filled; handles are cut or filled with the least change (`solid_ball.as_ball`).

    Parameters
    ----------
    mask : Volume
        The voxels of the organ.

    Raises
    ------
    UserError
        Where the mask is empty, only a few voxels large, or keeps its handles.
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
    h = float(mask.spacing.min())
    rough = _signed_distance(solid, mask.spacing[::-1])
    smooth = _smoothed(rough, mask.spacing[::-1])
    level = _exact_away(_resample(smooth, mask.spacing[::-1], h), h)
    solid = level < 0.0
    ball = as_ball(solid, mask.name)
    filled, cut = (float(np.count_nonzero(part)) * h**3 * 1e-3 for part in (ball & ~solid, solid & ~ball))
    return Wall(_patched(level, ball, h), h, mask.to_points(first), mask.direction, count - 1, filled, cut)


def _signed_distance(solid: Mask, sampling: Floats) -> NDArray[np.float32]:
    """Return distances, zero halfway between inner and outer voxels, exact between voxel centres otherwise."""
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


def _enclosed(level: Array, h: float) -> float:
    """Return the volume inside a level set, mm, in voxels; those on the wall count by how far they lie inside."""
    return float(np.clip(0.5 - level / h, 0.0, 1.0).sum(dtype=np.float64))


def _smooth_distance(solid: Mask, h: float) -> NDArray[np.float32]:
    """Return the signed distance, smooth near the wall so that voxel steps don't show, exact away from it."""
    return _exact_away(_smoothed(_signed_distance(solid, np.full(3, h)), np.full(3, h)), h)


def _exact_away(smooth: NDArray[np.float32], h: float) -> NDArray[np.float32]:
    """Return exact distances to the smooth level's inside from 2.5 voxels on: smoothing alone flattens the ridges."""
    exact = _signed_distance(smooth < 0.0, np.full(3, h))
    fraction = np.clip(np.abs(exact) / h - 1.5, 0.0, 1.0)
    return (smooth + fraction * (exact - smooth)).astype(np.float32)


def _resample(level: NDArray[np.float32], sampling: Floats, h: float) -> NDArray[np.float32]:
    if np.allclose(sampling, h, rtol=1e-3):
        return level
    shape = [int(np.floor((n - 1) * s / h)) + 1 for n, s in zip(level.shape, sampling, strict=True)]
    axes = [np.arange(n) * h / s for n, s in zip(shape, sampling, strict=True)]
    grid = np.meshgrid(*axes, indexing="ij")
    return ndimage.map_coordinates(level, grid, output=np.float32, order=3, mode="nearest")


def _patched(level: NDArray[np.float32], ball: Mask, h: float) -> NDArray[np.float32]:
    """Return the level with the changed solid `ball` as its inside; unchanged near the wall where nothing changed.

    Cuts and membranes one voxel thin are kept, and parts that meet only across a diagonal stay separated: smoothing and
    marching cubes could undo both.
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
    """Return the voxels of square cells whose solid voxels are two, across the diagonal."""
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
    """Return the wall after a closing by a ball, which fills narrower folds.

    Parameters
    ----------
    wall : Wall
        The wall.
    radius : float, mm
        Radius of the ball.
    smooth : bool, optional
        Whether the result is as smooth as the wall itself; otherwise it shows the voxels, in a fraction of the time.

    Returns
    -------
    Wall | None
        The closed wall; None where the closing makes a ring.
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
    """Return the wall of a closed surface on another wall's grid.

    Parameters
    ----------
    positions : Floats, shape (n, 3), mm
        Points on the grid.
    triangles : Ints, shape (t, 3)
        Corner indices, outward.
    wall : Wall
        The wall that gives the grid.

    Raises
    ------
    UserError
        Where the surface encloses no voxel.
    """
    size = np.array(wall.level.shape[::-1], dtype=np.int64)
    solid = largest_part(enclosed(off_grid(positions / wall.spacing), triangles, size))
    if not solid.any():
        raise UserError("the surface encloses no voxel; use a finer image")
    return replace(wall, level=_smooth_distance(solid, wall.spacing))
