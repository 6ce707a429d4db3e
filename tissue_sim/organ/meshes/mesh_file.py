"""Contents of a mesh file: named pieces of triangles, and remarks on how it was read."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from tissue_sim.array_types import Floats, Longs
from tissue_sim.organ.meshes import cell_surface

ROOM, ROOM_PER_BYTE = 1 << 28, 64  # bytes that reading a file may need, whatever its counts say


@dataclass(frozen=True, eq=False)
class Piece:
    """One named piece of a file.

    Attributes
    ----------
    name : str
        Name in the file, or an empty string.
    positions : Floats, shape (n, 3), in the file's unit
        Points.
    triangles : Longs, shape (t, 3)
        Corner indices.
    """

    name: str
    positions: Floats
    triangles: Longs


@dataclass(frozen=True, eq=False)
class MeshFile:
    """Content of a mesh file.

    Attributes
    ----------
    pieces : tuple[Piece, ...]
        Its named pieces.
    notes : tuple[str, ...]
        Remarks on how it was read, one line each.
    """

    pieces: tuple[Piece, ...]
    notes: tuple[str, ...] = ()


def surface_of_cells(positions: Floats, cells: Mapping[str, Longs]) -> MeshFile:
    """Return the surface of cells by meshio's names, see `cell_surface`.

    Parameters
    ----------
    positions : Floats, shape (n, 3), in the file's unit
        Points.
    cells : Mapping[str, Longs]
        Corner indices of cells, by their kind.
    """
    points, triangles, notes = cell_surface.surface_of(positions, cells)
    return MeshFile((Piece("", points, triangles),), notes)
