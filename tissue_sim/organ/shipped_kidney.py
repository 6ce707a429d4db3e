"""The kidney that ships, as built: the phantom's left kidney, through the real stages."""

from __future__ import annotations

import tempfile
from dataclasses import asdict
from pathlib import Path

import SimpleITK as sitk

from tissue_sim.organ.build_record import Progress
from tissue_sim.organ.imaging.image import read_image
from tissue_sim.organ.imaging.phantom import PhantomParameters, make_phantom
from tissue_sim.organ.making import Request, organ_from_image
from tissue_sim.organ.organ import Organ

KIDNEY = Path("config") / "organs" / "kidney_as_built.npz"
BACK = "y>0.9"  # where a kidney lies on the wall behind it: the patient frame's y points to the back


def make_kidney(progress: Progress | None = None) -> Organ:
    """Paint the phantom, write it as NIfTI, read it back, segment from one seed, build. Deterministic."""
    parameters = PhantomParameters()
    phantom = make_phantom(parameters)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "phantom.nii.gz"
        sitk.WriteImage(sitk.Cast(phantom.ct.to_sitk(), sitk.sitkInt16), str(path))
        ct = read_image(path)
    provenance = {"source": "synthetic abdominal CT", "phantom": asdict(parameters)}
    request = Request(name="kidney", organ="kidney", fixed=BACK, provenance=provenance)
    return organ_from_image(ct, phantom.seed_point, request, progress=progress)
