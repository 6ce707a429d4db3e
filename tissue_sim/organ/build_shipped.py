"""The kidney that ships, as built: the phantom's left kidney, through the real pipeline.

`python -m tissue_sim.organ.build_shipped`; `make organ` then calibrates it.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from dataclasses import asdict
from pathlib import Path

import SimpleITK as sitk

from tissue_sim.errors import UserError
from tissue_sim.organ.imaging.image import read_image
from tissue_sim.organ.imaging.phantom import PhantomParameters, make_phantom
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.pipeline import Progress, Request, organ_from_image

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


def main(argv: list[str] | None = None) -> int:
    """Write the kidney; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m tissue_sim.organ.build_shipped", description=__doc__)
    parser.add_argument("--out", type=Path, default=KIDNEY, help="organ file to write (default: %(default)s)")
    parser.add_argument("--report", type=Path, metavar="FILE.html", help="also write a page on how it was built")
    args = parser.parse_args(argv)
    out, progress = args.out, Progress(print)
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        organ = make_kidney(progress)
        organ.save(out)
        if args.report:
            from tissue_sim.organ.reporting.page import write_report

            write_report(progress.record, args.report, organ_file=out.name)
    except (UserError, OSError) as error:
        print(f"ship: error: {error}", file=sys.stderr)
        return 2
    print(f"{out}: {organ.volume * 1e6:.1f} mL, {organ.n_surface} points, {organ.n_atoms} atoms")
    return 0


if __name__ == "__main__":
    sys.exit(main())
