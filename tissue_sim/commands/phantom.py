"""Command `tissue_sim phantom`: a synthetic CT for trials, with a kidney that is known."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from tissue_sim.errors import UserError
from tissue_sim.interrupts import leaving
from tissue_sim.outputs import check_folder

if TYPE_CHECKING:
    from tissue_sim.organ.imaging.image import Volume

_ENDINGS = (".nii.gz", ".nii", ".nrrd", ".mha")
_MOST_NOISE, _WIDEST_GAP = 200.0, 20.0  # HU; mm


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `tissue_sim phantom`."""
    parser.add_argument(
        "out",
        nargs="?",
        default="ct.nii.gz",
        metavar="OUT",
        help=f"CT to write, in the format of its extension: {', '.join(_ENDINGS)} (default: %(default)s)",
    )
    parser.add_argument("--mask", metavar="FILE", help="also write the mask of its left kidney")
    parser.add_argument(
        "--noise", type=float, default=12.0, metavar="HU", help="standard deviation of the noise (default: %(default)g)"
    )
    parser.add_argument(
        "--gap",
        type=float,
        default=0.0,
        metavar="MM",
        help="thickness of fat between the kidney and its neighbours (default: %(default)g, they touch)",
    )


def run(args: argparse.Namespace) -> int:
    """Write the phantom's CT, and its kidney's mask on request; return 0. Raises UserError."""
    for path in (args.out, args.mask):
        if path is not None:
            _check(path)
    if args.mask is not None and Path(args.mask).resolve() == Path(args.out).resolve():
        raise UserError(f"--mask and the CT are both {args.out}; name two files")
    for option, value, most in (("--noise", args.noise, _MOST_NOISE), ("--gap", args.gap, _WIDEST_GAP)):
        if not 0.0 <= value <= most:
            raise UserError(f"{option} {value:g} must lie within 0..{most:g}")
    try:
        from tissue_sim.organ.imaging.phantom import PhantomParameters, make_phantom
    except ModuleNotFoundError as error:
        raise UserError(f"a phantom needs {error.name}; install the extra: pip install 'tissue_sim[image]'") from None
    with leaving("nothing was written"):
        phantom = make_phantom(PhantomParameters(noise=args.noise, gap=args.gap))
    kidney = float(phantom.kidney.array.sum()) * phantom.kidney.voxel_volume
    seed = ",".join(f"{value:.0f}" for value in phantom.seed_point)
    _write(args.out, phantom.ct, "int16")
    size, spacing = (" x ".join(f"{value:g}" for value in values) for values in (phantom.ct.size, phantom.ct.spacing))
    print(f"{args.out}: synthetic CT of {size} voxels of {spacing} mm, with a left kidney of {kidney:.1f} mL")
    if args.mask is not None:
        _write(args.mask, phantom.kidney, "uint8")
        print(f"{args.mask}: mask of the kidney")
    print(f"next: tissue_sim build {args.out} --seed {seed} --organ kidney --out kidney.npz --report")
    return 0


def _check(path: str) -> None:
    if not path.lower().endswith(_ENDINGS):
        raise UserError(f"{path}: unknown image format; use the extension {', '.join(_ENDINGS)}")
    check_folder(Path(path), path)


def _write(path: str, volume: Volume, kind: str) -> None:
    import SimpleITK as sitk

    try:
        with leaving(f"{path} may be incomplete"):
            sitk.WriteImage(volume.with_array(volume.array.astype(kind)).to_sitk(), path)
    except RuntimeError:
        raise UserError(f"cannot write {path}; check the free space and the permissions there") from None
