"""The surface of a mesh of cells: the boundary of its tetrahedra, or its triangles and quads."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from tissue_sim.array_types import Floats, Longs
from tissue_sim.organ.meshes.mesh_error import MeshError

_CORNERS = {"triangle": 3, "quad": 4, "tetra": 4}
_SOLIDS = ("hexahedron", "wedge", "pyramid", "polyhedron")
_CURVED = "took the corners of elements of second or higher order: curved sides are flat"


def surface_of(positions: Floats, cells: Mapping[str, Longs]) -> tuple[Floats, Longs, tuple[str, ...]]:
    """Return the boundary of the tetrahedra where there are any, else the triangles and quads.

    Parameters
    ----------
    positions : (n, 3)
    cells : rows of nodes by meshio's names, such as `tetra10`; elements of a higher order have their corners first

    Returns
    -------
    positions : (m, 3), those that are used
    triangles : (t, 3), wound outwards where they bound tetrahedra
    notes : remarks, one line each

    Raises
    ------
    ValueError
        For other solids, for nodes that are not there, and where there are neither triangles nor tetrahedra.
    """
    found, is_curved = _by_corners(cells, len(positions))
    triangles, quads, tetras = (found[name] for name in _CORNERS)
    notes = (_CURVED,) if is_curved else ()
    if len(tetras):
        boundary = _boundary(positions, tetras)
        return *_used(positions, boundary), (*notes, f"used the surface of {len(tetras)} tetrahedra")
    faces = np.concatenate([triangles, quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    if not len(faces):
        raise MeshError("no triangles and no tetrahedra")
    # Other points that no element uses are reported where the surface is repaired; the middles of sides are not.
    return (*_used(positions, faces), notes) if is_curved else (positions, faces, notes)


def _by_corners(cells: Mapping[str, Longs], count: int) -> tuple[dict[str, Longs], bool]:
    """Return the corners (k, 3) or (k, 4) of cells of each of _CORNERS, and whether any has nodes between them."""
    parts: dict[str, list[Longs]] = {name: [np.empty((0, width), dtype=np.int64)] for name, width in _CORNERS.items()}
    is_curved = False
    for kind, rows in cells.items():
        name = kind.rstrip("0123456789")
        if name in _SOLIDS and len(rows):
            raise MeshError(f"cells of the kind {name}: split them into tetrahedra first")
        if name not in _CORNERS or not len(rows):
            continue
        width = _CORNERS[name]
        if rows.shape[1] < width:
            raise MeshError(f"a {name} with fewer than {width} corners")
        is_curved |= rows.shape[1] > width
        corners = rows[:, :width]
        if not 0 <= corners.min() <= corners.max() < count:
            raise MeshError("a cell names a point that doesn't exist")
        parts[name].append(corners)
    return {name: np.concatenate(part) for name, part in parts.items()}, is_curved


def _boundary(positions: Floats, tetras: Longs) -> Longs:
    """Return the faces (t, 3) that one tetrahedron alone has, wound outwards."""
    corner = positions[tetras]
    along = np.einsum(
        "ij,ij->i",
        np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]),
        corner[:, 3] - corner[:, 0],
    )
    tetras = np.where((along < 0.0)[:, None], tetras[:, [0, 2, 1, 3]], tetras)
    faces = np.concatenate([tetras[:, k] for k in ([1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1])])
    _, first, count = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
    return faces[np.sort(first[count == 1])]


def _used(positions: Floats, triangles: Longs) -> tuple[Floats, Longs]:
    """Return those of the points that triangles use, and the triangles with their new numbers."""
    used, inverse = np.unique(triangles, return_inverse=True)
    return positions[used], inverse.reshape(-1, 3).astype(np.int64)
