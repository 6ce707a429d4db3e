"""Export of an organ's surface, its skeleton and its cells to files of other programs.

Positions are in the frame and order of the organ file, in metres or millimetres; no format here has a field for the
unit, so every file names it in a comment. OBJ, VTP and VTU keep double precision, PLY and STL surfaces single.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial import cKDTree

from tissue_sim.array_types import Array, Ints
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.reporting.vtk_xml import polydata, tetrahedra

if TYPE_CHECKING:
    from trimesh import Trimesh

Writer = Callable[[Organ, str], bytes]

UNITS = {"m": 1.0, "mm": 1e3}
_OBJ_DIGITS = 12  # after the point: a millionth of a micrometre


def bones(organ: Organ) -> Ints:
    """Return the pairs of neighbouring atoms: each atom and its neighbour towards the root.

    Parameters
    ----------
    organ : Organ
        The organ.

    Returns
    -------
    Ints, shape (m, 2)
        Atom indices.
    """
    child = np.flatnonzero(organ.atom_parent >= 0)
    return np.stack([child, organ.atom_parent[child]], axis=1).astype(np.int32)


def _comment(organ: Organ, unit: str, what: str = "surface") -> str:
    """Return a line of plain ASCII, without the word that some PLY readers take for the header's end anywhere."""
    name = " ".join(organ.name.encode("ascii", "replace").decode().replace("end_header", "end header").split())
    words = {"m": "metres", "mm": "millimetres"}[unit]
    return f"tissue_sim organ {name}: {what}, positions in {words}"


# surfaces ------------------------------------------------------------------------------------------


def surface_obj(organ: Organ, unit: str) -> bytes:
    """Return the surface as Wavefront OBJ."""
    from trimesh.exchange.obj import export_obj

    text = export_obj(
        _mesh(organ, unit),
        include_normals=False,
        include_color=False,
        include_texture=False,
        digits=_OBJ_DIGITS,
        header=_comment(organ, unit),
    )
    return (text.rstrip("\n") + "\n").encode()


def surface_ply(organ: Organ, unit: str) -> bytes:
    """Return the surface as binary PLY."""
    from trimesh.exchange.ply import export_ply

    content = export_ply(_mesh(organ, unit), vertex_normal=False)
    comment = f"comment {_comment(organ, unit)}\n".encode()
    return content.replace(b"end_header\n", comment + b"end_header\n", 1)


def surface_stl(organ: Organ, unit: str) -> bytes:
    """Return the surface as binary STL; the order of the points is lost, as STL has only triangles."""
    from trimesh.exchange.stl import export_stl

    return _comment(organ, unit).encode()[:80].ljust(80) + export_stl(_mesh(organ, unit))[80:]


def surface_vtp(organ: Organ, unit: str) -> bytes:
    """Return the surface as VTK XML PolyData with the model's data of each point."""
    n = organ.n_surface
    held = np.zeros(n, dtype=np.uint8)
    held[organ.fixed] = 1
    data: dict[str, Array] = {
        "held": held,
        "mass_kg": organ.mass[:n],
        "damping_kg_per_s": organ.damping[:n],
        "return_stiffness_N_per_m": organ.return_stiffness[:n],
        "nearest_atom": cKDTree(organ.atom_positions).query(organ.surface_positions)[1].astype(np.int32),
    }
    positions = organ.surface_positions * UNITS[unit]
    return polydata(positions, data, polygons=organ.surface_triangles, comment=_comment(organ, unit))


def _mesh(organ: Organ, unit: str) -> Trimesh:
    import trimesh

    return trimesh.Trimesh(organ.surface_positions * UNITS[unit], organ.surface_triangles, process=False)


# skeletons -----------------------------------------------------------------------------------------


def skeleton_obj(organ: Organ, unit: str) -> bytes:
    """Return the skeleton as Wavefront OBJ lines."""
    points = organ.atom_positions * UNITS[unit]
    rows = [f"# {_comment(organ, unit, 'skeleton')}"]
    rows += [f"v {x:.{_OBJ_DIGITS}f} {y:.{_OBJ_DIGITS}f} {z:.{_OBJ_DIGITS}f}" for x, y, z in points]
    rows += [f"l {i + 1} {j + 1}" for i, j in bones(organ)]
    return ("\n".join(rows) + "\n").encode()


def skeleton_ply(organ: Organ, unit: str) -> bytes:
    """Return the skeleton as ASCII PLY with edges; each point has its radius, in the same unit."""
    scale, links = UNITS[unit], bones(organ)
    rows = ["ply", "format ascii 1.0", f"comment {_comment(organ, unit, 'skeleton')}"]
    rows += [f"element vertex {organ.n_atoms}"]
    rows += [f"property double {name}" for name in ("x", "y", "z", "radius")]
    rows += [f"element edge {len(links)}", "property int vertex1", "property int vertex2", "end_header"]
    values = np.column_stack([organ.atom_positions, organ.atom_radius]) * scale
    rows += [" ".join(repr(float(v)) for v in row) for row in values]
    rows += [f"{i} {j}" for i, j in links]
    return ("\n".join(rows) + "\n").encode()


def skeleton_vtp(organ: Organ, unit: str) -> bytes:
    """Return the skeleton as VTK XML PolyData lines, with radius (in the same unit), mass and parent of each atom."""
    first = organ.n_surface
    data: dict[str, Array] = {
        f"radius_{unit}": organ.atom_radius * UNITS[unit],
        "mass_kg": organ.mass[first : first + organ.n_atoms],
        "parent": organ.atom_parent,
    }
    positions = organ.atom_positions * UNITS[unit]
    return polydata(positions, data, lines=bones(organ), comment=_comment(organ, unit, "skeleton"))


# cells ---------------------------------------------------------------------------------------------


def cells_vtu(organ: Organ, unit: str) -> bytes:
    """Return all nodes and cells as a VTK XML UnstructuredGrid with the model's data."""
    held = np.zeros(organ.n_nodes, dtype=np.uint8)
    held[organ.fixed] = 1
    nodes: dict[str, Array] = {"held": held, "mass_kg": organ.mass, "damping_kg_per_s": organ.damping}
    moduli: dict[str, Array] = {"mu_Pa": organ.cell_mu, "lambda_Pa": organ.cell_lambda}
    positions = organ.rest_positions * UNITS[unit]
    return tetrahedra(positions, organ.cell_nodes, nodes, moduli, comment=_comment(organ, unit, "cells"))


# Writers by suffix; each takes the organ and one of UNITS.
SURFACES: dict[str, Writer] = {".ply": surface_ply, ".obj": surface_obj, ".stl": surface_stl, ".vtp": surface_vtp}
LINES: dict[str, Writer] = {".ply": skeleton_ply, ".obj": skeleton_obj, ".vtp": skeleton_vtp}
CELLS: dict[str, Writer] = {".vtu": cells_vtu}
