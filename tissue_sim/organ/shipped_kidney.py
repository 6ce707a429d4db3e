"""Making of the kidneys that ship: the phantom's left kidney through the real stages, also with a tumour."""

from __future__ import annotations

import tempfile
from dataclasses import asdict
from pathlib import Path

import SimpleITK as sitk
import trimesh

from tissue_sim.organ.build_record import Progress
from tissue_sim.organ.imaging.image_file import read_image
from tissue_sim.organ.imaging.phantom import PhantomParameters, make_phantom
from tissue_sim.organ.inclusions import Inclusion
from tissue_sim.organ.normals import surface_normals
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.pipeline import organ_from_image
from tissue_sim.organ.request import Request
from tissue_sim.organ.surfaces.surface_distance import distance_to_surface
from tissue_sim.organ.topology import assemble_like

KIDNEY = Path("config") / "organs" / "kidney_as_built.npz"
BACK = "y>0.9"  # where a kidney lies on the wall behind it: the patient frame's y points to the back
TUMOUR, UNDER, STIFFER = 0.005, 0.005, 5.0  # m, its radius, and from it to the surface; times the tissue's moduli
_NEAREST = 0.98  # fraction of that depth which the surface must be away at least


def build_default_kidney(progress: Progress | None = None) -> Organ:
    """Paint the phantom, write it as NIfTI, read it back, segment from one seed, and build; deterministic.

    Parameters
    ----------
    progress : Progress | None, optional
        Receives the lines, the progress and the results of the stages.
    """
    parameters = PhantomParameters()
    phantom = make_phantom(parameters)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "phantom.nii.gz"
        sitk.WriteImage(sitk.Cast(phantom.ct.to_sitk(), sitk.sitkInt16), str(path))
        ct = read_image(path)
    provenance = {"source": "synthetic abdominal CT", "phantom": asdict(parameters)}
    request = Request(name="kidney", organ="kidney", fixed=BACK, provenance=provenance)
    return organ_from_image(ct, phantom.seed_point, request, progress=progress)


def with_tumour(kidney: Organ) -> Organ:
    """Return the kidney, reassembled, with a ball of stiffer tissue under its frontmost suitable point.

    Parameters
    ----------
    kidney : Organ
        The kidney.

    Returns
    -------
    Organ
        The kidney with the inclusion.
    """
    surface, triangles = kidney.surface_positions, kidney.surface_triangles
    deep = UNDER + TUMOUR
    middles = surface - deep * surface_normals(surface, triangles)
    under = distance_to_surface(middles, surface, triangles) > _NEAREST * deep
    middle = middles[under][middles[under, 1].argmin()]
    ball = trimesh.creation.icosphere(subdivisions=2, radius=TUMOUR)
    inclusion = Inclusion(ball.vertices + middle, ball.faces.astype("int32"), STIFFER)
    provenance = {
        **kidney.provenance,
        "inclusions": f"a ball of {2e3 * TUMOUR:g} mm, {1e3 * UNDER:g} mm under the front",
    }
    return assemble_like(kidney, name="kidney with a tumour", inclusions=[inclusion], provenance=provenance)
