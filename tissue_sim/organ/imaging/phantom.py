"""Synthetic abdominal CT with known ground truth: a left kidney among organs that touch it.

Shapes are signed distances (mm, negative inside) in the patient frame (LPS), painted with soft edges,
then blurred and made noisy. The same parameters give the same voxels.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from tissue_sim.array_types import Singles
from tissue_sim.organ.imaging.image import Volume

Grid = tuple[Singles, Singles, Singles]
Triple = tuple[float, float, float]

# Hounsfield units at 120 kV without contrast agent
AIR, FAT, KIDNEY, SPLEEN, MUSCLE, BOWEL, LIVER, BLOOD = -1000.0, -100.0, 32.0, 46.0, 55.0, 25.0, 56.0, 42.0
MARROW, CORTEX = 190.0, 480.0

_BOWEL: tuple[Triple, ...] = ((100.0, -5.0, -120.0), (94.0, 2.0, -28.0), (68.0, -12.0, 0.0), (20.0, -45.0, 12.0))
_VEIN: tuple[Triple, ...] = ((4.0, 22.0, 5.0), (22.0, 12.0, 3.0), (48.0, 33.0, 0.0))

KIDNEY_CENTRE: Triple = (66.0, 38.0, 0.0)  # mm
KIDNEY_SEMI_AXES: Triple = (28.0, 20.5, 57.0)  # mm across, front to back, along: 11 x 5.5 x 4 cm


@dataclass(frozen=True)
class PhantomParameters:
    """Parameters that vary between phantoms; lengths in mm, noise in HU."""

    spacing: Triple = (1.5, 1.5, 2.5)
    extent: Triple = (288.0, 204.0, 170.0)
    blur: float = 0.9  # standard deviation of the scanner's point spread
    noise: float = 12.0  # standard deviation in the finished image
    gap: float = 0.0  # fat between the kidney and its neighbours; 0: they touch
    seed: int = 2006


@dataclass(frozen=True, eq=False)
class Phantom:
    """CT with its ground truth.

    Attributes
    ----------
    ct : Volume, HU
        The image.
    kidney : Volume
        Mask of the kidney on the same grid.
    seed_point : NDArray[np.float64], shape (3,), mm
        Point inside the kidney.
    """

    ct: Volume
    kidney: Volume
    seed_point: NDArray[np.float64]


def make_phantom(parameters: PhantomParameters | None = None) -> Phantom:
    """Paint the abdomen that the parameters describe.

    Parameters
    ----------
    parameters : PhantomParameters | None, optional
        Parameters; None for the usual ones.

    Returns
    -------
    Phantom
        The image, the kidney's mask and a seed point.
    """
    p = parameters or PhantomParameters()
    spacing = np.array(p.spacing)
    size = np.maximum(np.round(np.array(p.extent) / spacing).astype(int), 8)
    origin = -0.5 * (size - 1) * spacing + np.array([0.0, 8.0, 0.0])
    grid = grid_of(size, spacing, origin)
    kidney = kidney_distance(grid)

    hu = np.full(tuple(size[::-1]), AIR, dtype=np.float32)
    soft = float(spacing.mean())
    for distance, value in _scene(grid, kidney, p.gap):
        alpha = np.clip(0.5 - distance / soft, 0.0, 1.0)
        hu += alpha * (value - hu)

    hu = gaussian_filter(hu, p.blur / spacing[::-1])
    hu += _noise(hu.shape, p)
    ct = Volume(np.round(hu).astype(np.float32), spacing, origin, np.eye(3), "phantom")
    mask = ct.with_array(kidney < 0.0)
    seed = np.array(KIDNEY_CENTRE) + _rotation() @ np.array([8.0, 0.0, 6.0])
    return Phantom(ct, mask, seed)


def kidney_distance(grid: Grid) -> Singles:
    """Return the approximate signed distance of the kidney: a bent ellipsoid with a hilum on its medial side.

    Parameters
    ----------
    grid : Grid, three arrays of shape (nz, ny, nx), mm
        Coordinates x, y, z of the voxels.

    Returns
    -------
    Singles, shape (nz, ny, nx), mm
        Signed distance, negative inside.
    """
    u, v, w = _local(grid)
    bean = ellipsoid(u + np.float32(0.0035) * w * w - np.float32(3.0), v, w, KIDNEY_SEMI_AXES)
    hilum = ellipsoid(u + 26.0, v + 2.0, w, (17.0, 9.0, 16.0))
    return smooth_cut(bean, hilum, 4.0)


def body_distance(grid: Grid, within: float = 0.0) -> Singles:
    """Return the approximate signed distance of the trunk, or of a shape inside it.

    Parameters
    ----------
    grid : Grid, three arrays of shape (nz, ny, nx), mm
        Coordinates x, y, z of the voxels.
    within : float, mm, optional
        Distance of the shape from the skin.

    Returns
    -------
    Singles, shape (nz, ny, nx), mm
        Signed distance, negative inside.
    """
    x, y, z = grid
    return ellipsoid(x, y - 5.0, 0.0 * z, (138.0 - within, 97.0 - within, 1e6))


def _scene(grid: Grid, kidney: Singles, gap: float) -> list[tuple[Singles, float]]:
    """Return the shapes in painting order with their HU; neighbours are cut along the kidney's surface."""
    x, y, z = grid
    body = body_distance(grid)
    wall = np.maximum(body + 12.0, -body - 24.0)
    spine = np.hypot(x, y - 58.0) - 22.0
    canal = np.hypot(x, y - 83.0) - 8.0
    neighbours: list[tuple[Callable[[Grid], Singles], float]] = [
        (lambda g: ellipsoid(g[0] - 110.0, g[1] - 30.0, g[2] - 46.0, (21.0, 42.0, 48.0)), SPLEEN),
        (lambda g: ellipsoid(g[0] - 27.0 - 0.1 * (30.0 - g[2]), g[1] - 56.0, 0.0 * g[2], (16.0, 20.0, 1e6)), MUSCLE),
        (lambda g: ellipsoid(g[0] - 62.0, g[1] - 80.0, 0.0 * g[2], (42.0, 18.0, 1e6)), MUSCLE),
        (lambda g: _tube(g, _BOWEL, 17.0), BOWEL),
        (lambda g: _tube(g, _VEIN, 4.5), BLOOD),
    ]
    cut = gap - kidney
    painted: list[tuple[Singles, float]] = [
        (body, FAT),
        (np.maximum(wall, cut), MUSCLE),
        (np.maximum(ellipsoid(x + 70.0, y + 2.0, z - 40.0, (66.0, 62.0, 62.0)), body + 14.0), LIVER),
        (ellipsoid(x + 66.0, y - 38.0, z + 22.0, (26.0, 20.0, 52.0)), KIDNEY),
        (_tube(grid, ((8.0, 26.0, -120.0), (8.0, 26.0, 120.0)), 10.0), BLOOD),
    ]
    painted += [(np.maximum(shape(grid), cut), value) for shape, value in neighbours]
    painted += [
        (spine, CORTEX),
        (spine + 4.0, MARROW),
        (canal, MUSCLE),
        (_tube(grid, ((97.0, -4.0, -62.0), (95.0, -3.0, -42.0)), 7.0), -800.0),
        (kidney, KIDNEY),
    ]
    return painted


def grid_of(size: NDArray[np.int_], spacing: NDArray[np.float64], origin: NDArray[np.float64]) -> Grid:
    """Return the coordinates of the centres of voxels.

    Parameters
    ----------
    size : NDArray[np.int_], shape (3,)
        Number of voxels along x, y, z.
    spacing : NDArray[np.float64], shape (3,), mm
        Distance of voxels.
    origin : NDArray[np.float64], shape (3,), mm
        Centre of the first voxel.

    Returns
    -------
    Grid
        Coordinates x, y, z, mm, of shape (nz, ny, nx) each.
    """
    x, y, z = (origin[k] + spacing[k] * np.arange(size[k]) for k in range(3))
    shape = (size[2], size[1], size[0])
    return tuple(  # type: ignore[return-value]
        np.broadcast_to(axis, shape).astype(np.float32)
        for axis in (x[None, None, :], y[None, :, None], z[:, None, None])
    )


def _rotation() -> NDArray[np.float64]:
    """Return the kidney's axes as columns: lateral, front to back, longitudinal; its upper pole leans in and back."""
    inward, back = np.deg2rad(12.0), np.deg2rad(8.0)
    about_y = np.array([[np.cos(inward), 0.0, -np.sin(inward)], [0.0, 1.0, 0.0], [np.sin(inward), 0.0, np.cos(inward)]])
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, np.cos(back), np.sin(back)], [0.0, -np.sin(back), np.cos(back)]])
    return about_x @ about_y


def _local(grid: Grid) -> Grid:
    axes = _rotation().astype(np.float32)
    p = [grid[k] - np.float32(KIDNEY_CENTRE[k]) for k in range(3)]
    return tuple(sum(axes[k, m] * p[k] for k in range(3)) for m in range(3))  # type: ignore[return-value]


def ellipsoid(x: Singles, y: Singles, z: Singles, semi_axes: Triple) -> Singles:
    """Return the first-order distance to an ellipsoid: f (f - 1) / |grad f| with f the scaled radius.

    Parameters
    ----------
    x, y, z : Singles, mm
        Coordinates from the centre.
    semi_axes : Triple, mm
        Semi-axes along x, y, z.

    Returns
    -------
    Singles, mm
        Distance, negative inside.
    """
    a, b, c = (np.float32(s) for s in semi_axes)
    f = np.sqrt((x / a) ** 2 + (y / b) ** 2 + (z / c) ** 2)
    slope = np.sqrt((x / a**2) ** 2 + (y / b**2) ** 2 + (z / c**2) ** 2)
    return f * (f - 1.0) / np.maximum(slope, np.float32(1e-6))


def _tube(grid: Grid, points: tuple[Triple, ...], radius: float) -> Singles:
    """Return the distance to a polyline, thickened to `radius`."""
    best = np.full(grid[0].shape, np.inf, dtype=np.float32)
    for start, end in itertools.pairwise(points):
        a, d = np.array(start, dtype=np.float32), np.array(end, dtype=np.float32) - np.array(start, dtype=np.float32)
        p = [grid[k] - a[k] for k in range(3)]
        t = np.clip(sum(p[k] * d[k] for k in range(3)) / np.dot(d, d), 0.0, 1.0)
        best = np.minimum(best, np.sqrt(sum((p[k] - t * d[k]) ** 2 for k in range(3))))
    return best - np.float32(radius)


def smooth_cut(shape: Singles, tool: Singles, radius: float) -> Singles:
    """Return the distance of `shape` without `tool`, its edge rounded by a polynomial smooth maximum.

    Parameters
    ----------
    shape : Singles, mm
        Signed distance of the shape.
    tool : Singles, mm
        Signed distance of what is cut off.
    radius : float, mm
        Width over which the edge is rounded.

    Returns
    -------
    Singles, mm
        Signed distance of the difference.
    """
    h = np.clip(0.5 + 0.5 * (shape + tool) / radius, 0.0, 1.0)
    return (-tool) * (1.0 - h) + shape * h + radius * h * (1.0 - h)


def _noise(shape: tuple[int, ...], p: PhantomParameters) -> Singles:
    """Return grainy noise as of a scanner: correlated over a voxel, of the standard deviation asked for."""
    white = np.random.default_rng(p.seed).standard_normal(shape, dtype=np.float32)
    grain = gaussian_filter(white, 0.5)
    return np.float32(p.noise) * grain / max(float(grain.std()), 1e-9)
