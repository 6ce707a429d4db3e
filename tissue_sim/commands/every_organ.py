"""Build and calibrate every organ of a folder of organ data, with defaults, and refine those that are too coarse.

`python -m tissue_sim.commands.every_organ --data DATA --out FOLDER`.
The data is not part of the project: masks of a CT, organs of the Human Reference Atlas, SOFA's meshes, a colon.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import NamedTuple

from tissue_sim.calibration.coarseness import coarseness
from tissue_sim.calibration.stiffness import Settings
from tissue_sim.commands import build
from tissue_sim.commands.calibrate_many import add_cluster, calibrate_many, check_cluster, write_figures
from tissue_sim.errors import UserError
from tissue_sim.organ.organ import Organ
from tissue_sim.outputs import check_file
from tissue_sim.unexpected_errors import catch_all

_LIVER, _HEART = 0.2, 0.12  # m, longest side of meshes without a unit


class Source(NamedTuple):
    """Organ file in the folder, and the options beyond defaults with which it is built."""

    name: str
    file: str
    options: tuple[str, ...] = ()


def _mask(name: str, *options: str, file: str = "") -> Source:
    return Source(name, f"ct_abdomen/{file or name}.nii.gz", options)


def _sofa(name: str, file: str, length: float) -> Source:
    return Source(name, f"sofa_meshes/{file}", ("--length", f"{length:g}"))


SOURCES = (
    _mask("kidney_left"),
    _mask("kidney_right"),
    _mask("spleen"),
    _mask("liver"),
    _mask("liver_cut", "--fixed", "z>0.9", file="liver"),  # held where the CT cuts it off flat
    _mask("aorta"),
    _mask("portal_vein", file="portal_vein_and_splenic_vein"),
    _mask("colon"),
    Source("hra_kidney", "hra_organs/kidney_left_solid.stl", ("--unit", "mm")),
    Source("hra_spleen", "hra_organs/VH_F_Spleen.glb"),
    Source("hra_heart", "hra_organs/v1.2_VH_F_Heart.glb", ("--merge-parts",)),
    _sofa("sofa_liver_smooth", "liver-smooth.obj", _LIVER),
    _sofa("sofa_liver", "liver.obj", _LIVER),
    _sofa("sofa_liver2", "liver2.obj", _LIVER),
    _sofa("sofa_liver_msh", "liver.msh", _LIVER),
    _sofa("sofa_heart", "coeur1.trian", _HEART),
    _sofa("sofa_aneurysm", "aneurysm3D_1.off", _HEART),
    Source(
        "large_intestine",
        "large_intestine/EdinGCA_3D_00090_Surfaces_large_intestine_20k.vtk",
        ("--unit", "mm"),
    ),
)


def main() -> int:
    """Build what there is, calibrate it, print the table, and return 0, or 2 for invalid use.

    An organ that is refused is not a failure: its row says what to change.
    """
    parser = argparse.ArgumentParser(prog="python -m tissue_sim.commands.every_organ", description=__doc__)
    parser.add_argument("--data", required=True, metavar="FOLDER", help="folder of the organ data")
    parser.add_argument("--out", required=True, metavar="FOLDER", help="folder for built and calibrated organs")
    parser.add_argument("--only", nargs="+", metavar="NAME", help="names of the organs to calibrate (default: all)")
    parser.add_argument("--json", metavar="FILE", help="JSON file for all figures")
    add_cluster(parser)
    args = parser.parse_args()
    try:
        check_cluster(args)
        if args.json:
            check_file("--json", Path(args.json), ".json", "the figures")
        chosen = [source for source in SOURCES if not args.only or source.name in args.only]
        organs = built(chosen, Path(args.data), Path(args.out) / "built")
        outputs = [Path(args.out) / organ.name for organ in organs]
        found = calibrate_many(organs, outputs, Settings(), args.jobs or 1, args.scheduler)
        if args.json:
            write_figures(found, Path(args.json))
    except UserError as error:
        sys.stderr.write(f"error: {error}\n")
        return 2
    return 0


def built(sources: list[Source], data: Path, folder: Path) -> list[Path]:
    """Build the sources that exist, and return the organ files of those that can be built.

    An organ that is too coarse for calibration is followed by a refined one, with `_refined` in its name.
    Raises UserError when there is none.
    """
    folder.mkdir(parents=True, exist_ok=True)
    found = []
    for source in sources:
        file, out = data / source.file, folder / f"{source.name}.npz"
        if not file.is_file():
            continue
        try:
            _build(source.name, file, source.options, out)
            found.append(out)
            if coarseness(Organ.load(out)) is not None:
                name = f"{source.name}_refined"
                _build(name, file, (*source.options, "--refine", "auto"), out.with_stem(name))
                found.append(out.with_stem(name))
        except UserError as error:
            print(f"{source.name}: not built: {error}")
    if not found:
        raise UserError(f"no organ in {data} can be built; name the folder of the organ data with --data")
    return found


def _build(name: str, file: Path, options: tuple[str, ...], out: Path) -> None:
    """Build an organ file from a mask or a mesh. Raises UserError as `tissue_sim build` does."""
    parser = argparse.ArgumentParser()
    build.add_arguments(parser)
    given = ("--mask" if file.name.endswith(".nii.gz") else "--surface", str(file), "--name", name)
    build.run(parser.parse_args([*given, *options, "--out", str(out)]))


if __name__ == "__main__":
    catch_all("every_organ", "organs that are ready stay in their folder, and calibrated ones are kept")
    sys.exit(main())
