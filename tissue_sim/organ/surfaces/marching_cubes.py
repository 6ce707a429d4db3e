"""Surfaces by marching cubes: of a wall, and of a mask for the report."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from skimage.measure import marching_cubes

from tissue_sim.array_types import Floats, Ints
from tissue_sim.errors import UserError
from tissue_sim.organ.imaging.image import Volume
from tissue_sim.organ.surfaces.surface import Wall
from tissue_sim.organ.surfaces.surface_quality import (
    SurfaceQuality,
    measure,
)


def marching_cubes_surface(wall: Wall) -> tuple[Floats, Ints]:
    """Return the largest closed component of the wall by marching cubes.

    Parameters
    ----------
    wall : Wall
        The wall.

    Returns
    -------
    tuple[Floats, Ints]
        Points, shape (n, 3), mm, and triangles, shape (t, 3), outward.
    """
    positions, triangles, _, _ = marching_cubes(wall.level, 0.0, spacing=(wall.spacing,) * 3, allow_degenerate=False)
    return largest_component(positions[:, ::-1].astype(np.float64), triangles[:, ::-1].astype(np.int32))


@dataclass(frozen=True)
class MarchingCubesReport:
    """Counts and measures of a marching cubes surface, as the paper counts them; lengths in mm.

    Attributes
    ----------
    points : int
        Points of the largest closed component.
    triangles : int
        Triangles of the largest closed component.
    islands : int
        Number of other closed components that enclose tissue.
    hollows : int
        Number of closed components that enclose a cavity.
    handles : int
        Handles of the largest component.
    quality : SurfaceQuality
        Measures of the largest component.
    """

    points: int
    triangles: int
    islands: int
    hollows: int
    handles: int
    quality: SurfaceQuality

    @property
    def fragments(self) -> int:
        """Number of closed components other than the largest."""
        return self.islands + self.hollows


def marching_cubes_report(source: Wall | Volume) -> MarchingCubesReport:
    """Return counts and measures of marching cubes on a wall's level set, or on a mask as segmented.

    Parameters
    ----------
    source : Wall | Volume
        The wall or the mask.

    Raises
    ------
    UserError
        Where a mask is empty.

    References
    ----------
    Lorensen & Cline 1987: Marching cubes.
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
    """Return the component of every point, (n,), and the signed volume that each encloses."""
    n = len(positions)
    links = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]]])
    graph = coo_matrix((np.ones(len(links)), (links[:, 0], links[:, 1])), shape=(n, n))
    _, label = connected_components(graph, directed=False)
    a, b, c = (positions[triangles[:, k]] for k in range(3))
    signed = np.einsum("ij,ij->i", a, np.cross(b, c)) / 6.0
    return label, np.bincount(label[triangles[:, 0]], weights=signed)


def largest_component(positions: Floats, triangles: Ints) -> tuple[Floats, Ints]:
    """Return the component with the largest enclosed volume, wound outward, without unused points."""
    label, volume = _components(positions, triangles)
    chosen = int(np.abs(volume).argmax())
    triangles = triangles[label[triangles[:, 0]] == chosen]
    if volume[chosen] < 0.0:
        triangles = triangles[:, ::-1]
    used, inverse = np.unique(triangles, return_inverse=True)
    return positions[used], inverse.reshape(-1, 3).astype(np.int32)
