"""The slab that `tissue_sim bench palpation --places N --slab` presses."""

from __future__ import annotations

import sys

import numpy as np

from tissue_sim import progress
from tissue_sim.organ.organ import Organ
from tissue_sim.result_cache import user_cache
from tissue_sim.version import __version__

SLAB = np.array([0.06, 0.06, 0.025])  # m


def slab() -> Organ:
    """Return a slab of 60 x 60 x 25 mm that lies on its clamp, calibrated with defaults: four minutes, once.

    It is kept in the user's cache.
    """
    from tissue_sim.bench.measured.body import calibrated

    folder = user_cache() / f"slab-{__version__}"
    path = folder / "slab.npz"
    if not path.is_file():
        folder.mkdir(parents=True, exist_ok=True)
        calibrated(slab_as_built(), folder, progress.Stages())
    print(f"organ: {path}", file=sys.stderr)
    return Organ.load(path)


def slab_as_built() -> Organ:
    """Return the slab with the balloon's points and nothing fitted."""
    import trimesh

    from tissue_sim.organ.meshes.mesh_input import SurfaceMesh
    from tissue_sim.organ.pipeline import organ_from_mesh
    from tissue_sim.organ.request import Request

    box = trimesh.creation.box(SLAB)
    for _ in range(3):
        box = box.subdivide()
    mesh = SurfaceMesh(np.asarray(box.vertices), np.asarray(box.faces, dtype=np.int32), ())
    return organ_from_mesh(mesh, Request(name="slab", fixed="z<0.1"))
