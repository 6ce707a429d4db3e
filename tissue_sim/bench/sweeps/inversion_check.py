"""Inversion of an organ, judged by its geometry alone."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from tissue_sim.array_types import Floats, Ints, Longs
from tissue_sim.organ.edges import directed_edges
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.surface_checks import signed_volume

_FLAT = 1e-3  # of the median, below which the sign of a volume at rest means nothing
_FOLDED = -0.5  # cosine between the normals of two neighbours that lie on each other


class Turned(NamedTuple):
    """Inverted parts."""

    cells: int  # tetrahedra of a surface triangle and its nearest inner node, with the opposite sign
    folds: int  # edges whose two triangles lie folded on each other, and didn't at rest
    volume: float  # enclosed volume over that at rest; negative: inverted


class InversionCheck:
    """Orientation of an organ's cells at rest."""

    def __init__(self, organ: Organ) -> None:
        rest = organ.rest_positions
        triangles = organ.surface_triangles
        inner = rest[organ.n_surface :]
        nearest = cKDTree(inner).query(rest[triangles].mean(axis=1))[1] + organ.n_surface
        self._cells = np.column_stack([triangles, nearest]).astype(np.int64)
        volume = _volumes(rest, self._cells)
        self._cells = self._cells[volume > _FLAT * np.median(volume)]
        self._triangles = triangles
        self._pairs = _neighbours(triangles)
        self._pairs = self._pairs[_cosines(rest, triangles, self._pairs) > _FOLDED]
        self._volume = signed_volume(rest, triangles)

    def look(self, positions: Floats) -> Turned:
        """Return what is inverted at positions (n, 3) m of the nodes."""
        return Turned(
            cells=int(np.count_nonzero(_volumes(positions, self._cells) <= 0.0)),
            folds=int(np.count_nonzero(_cosines(positions, self._triangles, self._pairs) <= _FOLDED)),
            volume=signed_volume(positions, self._triangles) / self._volume,
        )


def _volumes(positions: Floats, cells: Longs) -> Floats:
    """Return six times the signed volumes (c,) m^3: positive where the apex lies on the inner side."""
    a, b, c, apex = (positions[cells[:, k]] for k in range(4))
    return np.einsum("ij,ij->i", np.cross(b - a, c - a), a - apex)


def _neighbours(triangles: Ints) -> Longs:
    """Return pairs (e, 2) of triangles that share an edge."""
    edges = np.sort(directed_edges(triangles), axis=1)
    owner = np.tile(np.arange(len(triangles), dtype=np.int64), 3)
    order = np.lexsort(edges.T)
    return owner[order].reshape(-1, 2)


def _cosines(positions: Floats, triangles: Ints, pairs: Longs) -> Floats:
    a, b, c = (positions[triangles[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)
    return np.einsum("ij,ij->i", normal[pairs[:, 0]], normal[pairs[:, 1]])
