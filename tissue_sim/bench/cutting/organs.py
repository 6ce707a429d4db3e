"""The organs that `tissue_sim bench cut --accuracy` cuts: the kidney of this package, a slab, and a liver of a mesh."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from pathlib import Path

from tissue_sim import progress
from tissue_sim.bench.palpation.slab import slab
from tissue_sim.errors import UserError
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.shipped import shipped_organ
from tissue_sim.result_cache import user_cache
from tissue_sim.version import __version__

LIVER = "sofa_meshes/liver-smooth.obj"  # within the folder of the data
LONGEST = 0.2  # m, longest side of that mesh, which has no unit


def kidney() -> Organ:
    """Return the kidney of this package."""
    return Organ.load(shipped_organ())


def liver(data: Path | None) -> Organ:
    """Return a liver that is built and calibrated with defaults: some minutes, once. It is kept in the user's cache.

    data: folder of the data, None where there is none. Raises UserError without the mesh.
    """
    folder = user_cache() / f"liver-{__version__}"
    path = folder / "liver.npz"
    if data is None or not (data / LIVER).is_file():
        raise UserError(f"no {LIVER}; name the folder of the organ data with --data FOLDER")
    if not path.is_file():
        from tissue_sim.bench.measured.body import calibrated
        from tissue_sim.organ.meshes.mesh_input import read_mesh
        from tissue_sim.organ.pipeline import organ_from_mesh
        from tissue_sim.organ.request import Request

        folder.mkdir(parents=True, exist_ok=True)
        built = organ_from_mesh(read_mesh(data / LIVER, longest=LONGEST), Request(name="liver"))
        calibrated(built, folder, progress.Stages())
    print(f"organ: {path}", file=sys.stderr)
    return Organ.load(path)


def makers(data: Path | None) -> Mapping[str, Callable[[], Organ]]:
    """Return what makes each organ, by name. data: folder of the data, None where there is none."""
    return {"kidney": kidney, "slab": slab, "liver": lambda: liver(data)}
