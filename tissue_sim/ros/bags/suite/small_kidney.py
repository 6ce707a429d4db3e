"""The organ of the suite: the kidney that ships, with so few points that a bag with it is small."""

from __future__ import annotations

import tempfile
from pathlib import Path

import trimesh

from tissue_sim.organ.cell_mesh import with_cells
from tissue_sim.organ.meshes.mesh_input import read_mesh
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.pipeline import organ_from_mesh
from tissue_sim.organ.request import Request
from tissue_sim.organ.shipped import AS_BUILT, shipped_organ
from tissue_sim.organ.shipped_kidney import BACK
from tissue_sim.organ.topology import assemble_like

POINTS, INTERIOR = 194, 40


def make_small_kidney() -> Organ:
    """Make it by the usual stages from the surface that ships, with cells; not calibrated."""
    kidney = Organ.load(shipped_organ(AS_BUILT))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "kidney.ply"
        trimesh.Trimesh(kidney.surface_positions, kidney.surface_triangles, process=False).export(path)
        mesh = read_mesh(path, "m")
    built = organ_from_mesh(mesh, Request(name="small kidney", points=POINTS, fixed=BACK))
    return with_cells(assemble_like(built, interior_atoms=INTERIOR))
