"""Organs from triangle meshes: reading, refusing or repairing, and voxels of what they enclose."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

from tissue_sim.errors import UserError
from tissue_sim.organ.image import MM, Volume
from tissue_sim.organ.organ import signed_volume
from tissue_sim.organ.voxels import enclosed, off_grid

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

UNITS = {"mm": MM, "m": 1.0}
FORMATS = (".glb", ".gltf", ".obj", ".off", ".ply", ".stl")
_METRES = (".glb", ".gltf")  # the format fixes the unit
_LONGEST_AXIS = 128  # voxels along the longest side
_MOST_VOXELS = 3e5  # inside
_THIN = 0.1  # relative volume that voxels may miss


@dataclass(frozen=True, eq=False)
class SurfaceMesh:
    """A closed outward surface: positions (n, 3) m, triangles (t, 3), and what was repaired, one line each."""

    positions: Floats
    triangles: Ints
    repairs: tuple[str, ...]


def read_mesh(path: str | Path, unit: str | None = None) -> SurfaceMesh:
    """Read a closed surface from OBJ, STL, PLY, OFF or glTF.

    unit: `mm` or `m`, needed for every format but glTF, which is in metres. The points keep their order;
    points that coincide (STL) are merged. Inward or mixed winding is repaired and told in `repairs`.
    Raises UserError naming the file when it is missing, unreadable, open (with the number
    of open edges), or of several parts.
    """
    source = Path(path)
    if not source.is_file():
        raise UserError(f"surface {source} does not exist; name a mesh file ({', '.join(FORMATS)})")
    suffix = source.suffix.lower()
    if suffix not in FORMATS:
        raise UserError(f"surface {source} has no known mesh format; use one of {', '.join(FORMATS)}")
    if unit is None and suffix not in _METRES:
        raise UserError(
            f"surface {source}: {suffix[1:].upper()} doesn't say its length unit; give --unit mm or --unit m"
        )
    if unit is not None and unit not in UNITS:
        raise UserError(f"unit {unit} is not known; use mm or m")
    mesh = _load(source, suffix)
    scale = UNITS[unit or "m"]
    repairs = _repair(mesh, str(source))
    return SurfaceMesh(np.array(mesh.vertices, dtype=np.float64) * scale, np.array(mesh.faces, dtype=np.int32), repairs)


def _load(source: Path, suffix: str) -> trimesh.Trimesh:
    try:
        loaded: Any = trimesh.load(source, process=False, maintain_order=True)
        mesh = loaded.to_geometry() if isinstance(loaded, trimesh.Scene) else loaded
    except Exception as error:  # trimesh and its loaders raise anything on damaged files
        raise UserError(f"surface {source} can't be read as a mesh ({type(error).__name__}); export it again") from None
    if not isinstance(mesh, trimesh.Trimesh) or len(mesh.faces) == 0:
        raise UserError(f"surface {source} holds no triangles")
    if not np.all(np.isfinite(mesh.vertices)):
        raise UserError(f"surface {source} has points that are not finite")
    return mesh


def _repair(mesh: trimesh.Trimesh, name: str) -> tuple[str, ...]:
    """Close what only looks open, turn triangles outward; refuse the rest. Changes the mesh."""
    repairs = []
    points = len(mesh.vertices)
    if not mesh.is_watertight:
        mesh.merge_vertices(merge_tex=True, merge_norm=True)
        mesh.update_faces(mesh.nondegenerate_faces(height=0.0))
        mesh.remove_unreferenced_vertices()
        if len(mesh.vertices) < points:
            repairs.append(f"merged {points - len(mesh.vertices)} coinciding points")
    edges = mesh.edges_sorted[trimesh.grouping.group_rows(mesh.edges_sorted, require_count=1)]
    if len(edges):
        raise UserError(f"surface {name} is open ({len(edges)} open edges); close its holes first")
    if not mesh.is_watertight:
        raise UserError(f"surface {name} has edges with more than two triangles; make it a simple closed surface first")
    parts = trimesh.graph.connected_component_labels(mesh.face_adjacency, node_count=len(mesh.faces))
    if parts.max() > 0:
        raise UserError(f"surface {name} has {parts.max() + 1} separate parts; keep one in the file")
    used = np.unique(mesh.faces)
    if len(used) < len(mesh.vertices):
        repairs.append(f"dropped {len(mesh.vertices) - len(used)} points that no triangle uses")
        mesh.remove_unreferenced_vertices()
    if not mesh.is_winding_consistent:
        trimesh.repair.fix_winding(mesh)
        repairs.append("made the winding consistent")
        if not mesh.is_winding_consistent:
            raise UserError(f"surface {name} can't be wound consistently (like a Moebius strip)")
    if mesh.volume < 0.0:
        mesh.invert()
        repairs.append("turned inward triangles outward")
    if mesh.volume <= 0.0:
        raise UserError(f"surface {name} encloses no volume")
    return tuple(repairs)


def voxelize(surface: SurfaceMesh, name: str, longest_axis: int = _LONGEST_AXIS) -> Volume:
    """Bool Volume of the voxels whose centre the surface encloses, on an isotropic grid in the mesh's frame.

    Raises UserError when the grid misses more than a tenth of the volume (thin shells).
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
            f"surface {name} is too thin, or folds through itself: {found * 1e-3:.1f} mL of voxels for"
            f" {exact * 1e-3:.1f} mL of solid"
        )
    return Volume(solid, np.full(3, pitch), origin, np.eye(3), name)
