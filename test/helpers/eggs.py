"""A small organ whose figures are known."""

from functools import cache

import trimesh

from tissue_sim.organ.topology import assemble_organ


@cache
def forked_egg():
    """An egg of 642 points around a forked skeleton of five atoms, 20 x 16 x 32 mm in half axes."""
    mesh = trimesh.creation.icosphere(subdivisions=3, radius=0.02)
    mesh.apply_scale([1.0, 0.8, 1.6])
    return assemble_organ(
        name="egg <1>",
        surface_positions=mesh.vertices,
        surface_triangles=mesh.faces,
        atom_positions=[[0, 0, -0.01], [0, 0, 0.0], [0, 0, 0.01], [0.005, 0, 0.015], [-0.005, 0, 0.015]],
        atom_radius=[0.01, 0.012, 0.01, 0.008, 0.007],
        atom_parent=[-1, 0, 1, 2, 2],
        fixed=[3, 1, 2],
        youngs_modulus=5000.0,
        provenance={"source": "egg.ply", "seed_mm": [1.0, -2.5, 3.0], "phantom": {"noise": 12, "gaps": [{"mm": 0.5}]}},
    )
