"""Synthetic upper abdomen: four organs in one patient frame (LPS), each GAP from the next.

Shapes are signed distances as the phantom's; the left kidney is the phantom's own, the right one its mirror image,
lower by half a vertebra, as it lies under the liver.
"""

from __future__ import annotations

import numpy as np

from tissue_sim.array_types import Singles
from tissue_sim.organ.imaging.image import Volume
from tissue_sim.organ.imaging.phantom import Grid, body_distance, ellipsoid, grid_of, kidney_distance, smooth_cut

SPACING = 2.0  # mm
GAP = 4.0  # mm of fat between neighbours
LOWEST, HIGHEST = (-140.0, -96.0, -84.0), (140.0, 110.0, 160.0)  # mm, corners of the image
LOWER = 12.0  # mm by which the right kidney lies lower
WALL = 16.0  # mm between the skin and an organ


def make_abdomen() -> dict[str, Volume]:
    """Return the masks of the organs on one grid; they are the same every time.

    Returns
    -------
    dict[str, Volume]
        Masks by name: liver, kidney_left, kidney_right, spleen.
    """
    low, high = np.array(LOWEST), np.array(HIGHEST)
    spacing = np.full(3, SPACING)
    size = np.round((high - low) / spacing).astype(int) + 1
    grid = grid_of(size, spacing, low)
    return {
        name: Volume(distance < 0.0, spacing, low, np.eye(3), name) for name, distance in organ_distances(grid).items()
    }


def organ_distances(grid: Grid) -> dict[str, Singles]:
    """Return the approximate signed distances (mm) of the organs, by name."""
    x, y, z = grid
    left, right = kidney_distance(grid), kidney_distance((-x, y, z + np.float32(LOWER)))
    inside = body_distance(grid, WALL)
    return {
        "liver": np.maximum(_cut_free(_liver(grid), right), inside),
        "kidney_left": left,
        "kidney_right": right,
        "spleen": np.maximum(_cut_free(_spleen(grid), left), inside),
    }


def _liver(grid: Grid) -> Singles:
    """Return a large right and a small left lobe, flat below, hollow in front of the spine."""
    x, y, z = grid
    right = ellipsoid(x + 58.0, y - 2.0, z - 70.0, (62.0, 62.0, 72.0))
    left = ellipsoid(x - 14.0, y + 28.0, z - 98.0, (66.0, 36.0, 36.0))
    lobes = -smooth_cut(-right, left, 16.0)
    below = np.float32(1.0 / np.hypot(1.0, 0.45)) * (z - 40.0 - 0.45 * (x + 40.0))
    spine = np.hypot(x, y - 58.0).astype(np.float32) - np.float32(34.0)
    return smooth_cut(smooth_cut(lobes, below, 12.0), spine, 8.0)


def _spleen(grid: Grid) -> Singles:
    """Return an ellipsoid that is dented by the stomach on its medial side."""
    x, y, z = grid
    whole = ellipsoid(x - 97.0, y - 28.0, z - 68.0, (22.0, 40.0, 52.0))
    stomach = ellipsoid(x - 60.0, y - 8.0, z - 78.0, (26.0, 38.0, 46.0))
    return smooth_cut(whole, stomach, 8.0)


def _cut_free(shape: Singles, neighbour: Singles) -> Singles:
    """Return a shape without what is nearer than GAP to its neighbour."""
    return smooth_cut(shape, neighbour - np.float32(GAP), 6.0)
