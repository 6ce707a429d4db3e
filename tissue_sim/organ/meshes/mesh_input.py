"""Triangle meshes as the source of an organ: reading, refusing or repairing, and voxels of what they enclose."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from tissue_sim.array_types import Array, Floats, Ints
from tissue_sim.errors import UserError
from tissue_sim.file_kinds import MESH, wrong_kind
from tissue_sim.organ.imaging.image import MM, Volume
from tissue_sim.organ.length_units import UNITS, is_organ
from tissue_sim.organ.meshes.mesh_error import MeshError
from tissue_sim.organ.meshes.mesh_file import MeshFile, Piece
from tissue_sim.organ.meshes.mesh_formats import FORMATS, read_pieces
from tissue_sim.organ.meshes.mesh_holes import capped_volume
from tissue_sim.organ.meshes.mesh_parts import choose, closed_part, split
from tissue_sim.organ.meshes.mesh_repair import longest_side
from tissue_sim.organ.meshes.mesh_union import merged
from tissue_sim.organ.meshes.voxels import enclosed, off_grid
from tissue_sim.organ.normals import triangle_area
from tissue_sim.organ.surface_checks import signed_volume

_METRES = (".glb", ".gltf")  # the format fixes the unit
_LONGEST_AXIS = 128  # voxels along the longest side
_MOST_VOXELS = 3e5  # inside
_SHORTEST = 1e-12  # of the longest side in the file's unit
_FARTHEST = 1e12  # of a coordinate in the file's unit: volumes of larger ones are not finite
_THIN = 0.1  # relative volume that voxels may miss
_FEW_TRIANGLES = 2000  # of about 1000 points: walls thinner than their edges are more than such a model can follow


@dataclass(frozen=True, eq=False)
class SurfaceMesh:
    """Closed outward surface of an organ.

    Attributes
    ----------
    positions : Floats, shape (n, 3), m
        Points.
    triangles : Ints, shape (t, 3)
        Corner indices, outward.
    repairs : tuple[str, ...]
        What was repaired, one line each.
    notes : tuple[str, ...]
        Remarks, one line each.
    """

    positions: Floats
    triangles: Ints
    repairs: tuple[str, ...]
    notes: tuple[str, ...] = ()

    @property
    def genus(self) -> int:
        """Number of handles of the surface: 0 for a ball, 1 for a ring."""
        edges = len(self.triangles) * 3 // 2
        return (2 - len(np.unique(self.triangles)) + edges - len(self.triangles)) // 2


def read_mesh(
    path: str | Path,
    unit: str | None = None,
    *,
    longest: float | None = None,
    part: int | str | None = None,
    merge_parts: bool = False,
) -> SurfaceMesh:
    """Read the closed surface of one organ from OBJ, STL, PLY, OFF, glTF, VTK, Gmsh or SOFA's .trian.

    The points keep their order. Coinciding points and narrow seams are merged where the surface is open, duplicated
    triangles and scraps left out, holes up to a tenth of the longest side filled, inward or mixed winding corrected;
    all of it is reported in `repairs`. glTF is turned from y up into the patient frame.

    Parameters
    ----------
    path : str | Path
        The file.
    unit : str | None, optional
        One of `UNITS`; needed for every format but glTF, which is in metres, unless `longest` is given.
    longest : float | None, m, optional
        Longest side of the organ, for files without a unit.
    part : int | str | None, optional
        Part to take where the mesh falls into several, by number (1 is the largest) or by its name in the file.
    merge_parts : bool, optional
        Whether everything that the parts enclose is joined, with new points.

    Raises
    ------
    UserError
        Where the file is missing, unreadable, too wide open, of several parts none of which dominates, a hollow shell,
        or of a size that is not an organ's.
    """
    source = Path(path)
    _check_source(source, unit, longest)
    return _closed(_load(source), str(source), unit, longest, part, merge_parts)


def piece_of(positions: Array, triangles: Array, name: str) -> Piece:
    """Return what `mesh_of` closes, from arrays.

    Parameters
    ----------
    positions : Array, shape (n, 3)
        Points, in any unit.
    triangles : Array, shape (t, 3)
        Indices of their corners.
    name : str
        What the surface is called in messages.

    Raises
    ------
    UserError
        For arrays of other shapes or without numbers.
    """
    for what, array in (("positions", positions), ("triangles", triangles)):
        if array.ndim != 2 or array.shape[1] != 3 or not len(array) or array.dtype.kind not in "fiu":
            raise UserError(f"surface {name}: {what} has shape {array.shape}; expected: numbers (n, 3)")
    if triangles.dtype.kind == "f":
        raise UserError(f"surface {name}: triangles must be whole numbers, indices of positions")
    return Piece(name, positions.astype(np.float64), triangles.astype(np.int64))


def mesh_of(
    piece: Piece,
    unit: str | None = "m",
    *,
    longest: float | None = None,
    part: int | str | None = None,
    merge_parts: bool = False,
) -> SurfaceMesh:
    """Return the closed surface of one organ, checked and repaired as `read_mesh` does.

    Parameters
    ----------
    piece : Piece
        Points, triangles and name.
    unit, longest, part, merge_parts
        As `read_mesh` takes them.

    Raises
    ------
    UserError
        As `read_mesh` does.
    """
    return _closed(_checked(MeshFile((piece,)), Path(piece.name)), piece.name, unit, longest, part, merge_parts)


def _closed(
    found: MeshFile,
    name: str,
    unit: str | None,
    longest: float | None,
    part: int | str | None,
    merge_parts: bool,
) -> SurfaceMesh:
    """Return the closed surface of what was read, in m."""
    scale = _factor(unit, longest)
    if scale is None:
        assert longest is not None
        side = longest_side(np.concatenate([piece.positions for piece in found.pieces]))
        if side < _SHORTEST:
            raise UserError(f"surface {name} has no triangles with an area")
        scale = longest / side
    parts = split(found.pieces, scale)
    if not parts:
        raise UserError(f"surface {name} has no triangles with an area")
    if merge_parts and part is not None:
        raise UserError("--part and --merge-parts were given; choose one")
    chosen = merged(parts, name) if merge_parts else closed_part(choose(parts, name, part), name)
    repairs, triangles = chosen.repairs, chosen.triangles
    volume = capped_volume(chosen.positions, triangles, ())
    if volume < 0.0:
        triangles = triangles[:, ::-1]
        repairs = (*repairs, "flipped inward triangles")
    size = longest_side(chosen.positions)
    if abs(volume) <= 1e-9 * size**3:
        raise UserError(f"surface {name} encloses no volume; it must be closed around the organ")
    positions = chosen.positions
    notes = list(found.notes)
    if longest is not None:
        positions = positions * (longest / size)
        notes.append(f"scaled: the longest side is {longest * 100.0:.3g} cm")
        size = longest
    _check_size(name, size, unit)
    surface = SurfaceMesh(positions, np.ascontiguousarray(triangles, dtype=np.int32), repairs)
    if surface.genus:
        handles = f"{surface.genus} handle{'s' if surface.genus > 1 else ''}"
        notes.append(
            f"the surface has {handles} (genus {surface.genus}); kept points preserve them, the wall closes them"
        )
    return replace(surface, notes=tuple(notes))


def _check_source(source: Path, unit: str | None, longest: float | None) -> None:
    """Refuse a file that can't be read, and one of unknown unit."""
    if source.is_dir():
        raise UserError(f"surface {source} is a folder; name a mesh file in it ({', '.join(FORMATS)})")
    if not source.is_file():
        raise UserError(f"surface {source} does not exist; name a mesh file ({', '.join(FORMATS)})")
    suffix = source.suffix.lower()
    if suffix not in FORMATS:
        raise UserError(f"surface {source} has no known mesh format; use one of {', '.join(FORMATS)}")
    if unit is None and longest is None and suffix not in _METRES:
        raise UserError(
            f"surface {source}: {suffix[1:].upper()} doesn't say its length unit; give --unit mm or --unit m"
            " (or cm, um, in), or the organ's longest side with --length METRES"
        )
    _factor(unit, longest)


def _factor(unit: str | None, longest: float | None) -> float | None:
    """Return the metres in a unit, m by default; None where the longest side is given instead."""
    if unit is not None and unit not in UNITS:
        raise UserError(f"unit {unit} is unknown; use one of {', '.join(UNITS)}")
    if longest is None:
        return UNITS[unit or "m"]
    if unit is not None:
        raise UserError("--unit and --length were given; choose one")
    if not is_organ(longest):
        raise UserError(f"--length {longest:g} m is not a plausible longest side; give metres, 0.005 to 1")
    return None


def _load(source: Path) -> MeshFile:
    try:
        if other := wrong_kind(source, MESH):
            raise UserError(f"surface {source} {other}, and not a mesh; name a mesh file ({', '.join(FORMATS)})")
        found = read_pieces(source)
    except MeshError as error:
        raise UserError(f"surface {source} can't be read as a mesh ({_reason(error)}); export it again") from None
    except (ModuleNotFoundError, UserError):
        raise
    except PermissionError as error:
        raise UserError(f"surface {source} can't be read: {error.strerror}") from None
    except Exception:  # trimesh, meshio and their loaders raise anything on damaged files
        suffix = source.suffix[1:].upper()
        raise UserError(
            f"surface {source} can't be read as a mesh (it is cut off, damaged or not {suffix}); export it again"
        ) from None
    return _checked(found, source)


def _checked(found: MeshFile, source: Path) -> MeshFile:
    if not any(len(piece.triangles) for piece in found.pieces):
        raise UserError(
            f"surface {source} has no triangles: it is cut off, damaged or of another format; export it again"
        )
    for piece in found.pieces:
        if piece.positions.shape[1:] != (3,):
            raise UserError(f"surface {source} is damaged: its points don't have three coordinates")
        if not np.all(np.abs(piece.positions) <= _FARTHEST):
            raise UserError(f"surface {source} has points that are not finite, or beyond {_FARTHEST:g}")
        if piece.triangles.size and not 0 <= piece.triangles.min() <= piece.triangles.max() < len(piece.positions):
            raise UserError(f"surface {source} is damaged: a triangle names a point that doesn't exist")
    return found


def _reason(error: MeshError) -> str:
    return " ".join(str(error).split())[:120]


def _check_size(name: str, size: float, unit: str | None) -> None:
    if is_organ(size):
        return
    fits = [other for other, scale in UNITS.items() if is_organ(size / UNITS[unit or "m"] * scale)]
    units = f"--unit {' or '.join(fits)}, or " if fits else ""
    raise UserError(
        f"surface {name} is {size:.3g} m long{f' with --unit {unit}' if unit else ''}, but an organ is 5 mm to 1 m;"
        f" give {units}its longest side with --length METRES"
    )


def voxelize(surface: SurfaceMesh, name: str, longest_axis: int = _LONGEST_AXIS) -> Volume:
    """Return the voxels whose centre the surface encloses, on an isotropic grid in the mesh's frame.

    Parameters
    ----------
    surface : SurfaceMesh
        The surface.
    name : str
        Name for messages.
    longest_axis : int, optional
        Number of voxels along the longest side.

    Raises
    ------
    UserError
        For a thin shell, whose walls are on average thinner than the distance of about 1000 points spread over it, and
        where the grid misses more than a tenth of the volume.
    """
    points = surface.positions / MM
    low, high = points.min(axis=0), points.max(axis=0)
    exact = signed_volume(points, surface.triangles)
    pitch = max(float((high - low).max()) / longest_axis, float(np.cbrt(exact / _MOST_VOXELS)))
    size = np.ceil((high - low) / pitch).astype(int) + 3
    origin = low - pitch
    solid = enclosed(off_grid((points - origin) / pitch), surface.triangles, size.astype(np.int64))
    found = float(solid.sum()) * pitch**3
    if abs(found - exact) > _THIN * exact:
        raise UserError(
            f"surface {name} is too thin, or intersects itself: {found * 1e-3:.1f} mL of voxels for"
            f" {exact * 1e-3:.1f} mL of solid"
        )
    area = float(triangle_area(points, surface.triangles).sum())
    thickness, edge = _wall_thickness(solid) * pitch, float(np.sqrt(area / _FEW_TRIANGLES * 4.0 / np.sqrt(3.0)))
    if thickness < edge:
        raise UserError(
            f"surface {name} is a thin shell: its walls have a mean thickness of {thickness:.2g} mm and a total"
            f" area of {area * 1e-2:.3g} cm2, whose points would be {edge:.2g} mm apart with 1000 points; an organ"
            " must be solid: fill its cavity first"
        )
    return Volume(solid, np.full(3, pitch), origin, np.eye(3), name)


def _wall_thickness(solid: NDArray[np.bool_]) -> float:
    """Return four times the mean depth, voxels: the thickness of a sheet, two thirds of a tube's, half a ball's."""
    return 4.0 * (float(ndimage.distance_transform_edt(solid)[solid].mean()) - 0.5)
