"""Command `tissue_sim build`: from a CT, a segmentation or a mesh to an organ file."""

from __future__ import annotations

import argparse
import dataclasses
import importlib.util
import itertools
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from functools import partial
from pathlib import Path

import numpy as np

from tissue_sim.array_types import Floats
from tissue_sim.commands.build_inclusions import parse_inclusions
from tissue_sim.commands.build_refine import HELP as REFINE_HELP
from tissue_sim.commands.build_refine import parse_refine
from tissue_sim.commands.law_options import add_law, law_of, with_law
from tissue_sim.errors import UserError
from tissue_sim.interrupts import leaving
from tissue_sim.organ.build import EXTRA, SourceOptions, digest_of, make, name_of, stem_of
from tissue_sim.organ.build_record import STAGES, Progress
from tissue_sim.organ.fixed_nodes import select_fixed
from tissue_sim.organ.request import MOST_ATOMS, SPARSE, Request
from tissue_sim.organ.segmenting.parameters import SegmentationParameters
from tissue_sim.organ.tool_resolution import FAIR, FAIR_WITHIN, FINE, FINE_WITHIN, usual_edge
from tissue_sim.outputs import check_file, check_folder
from tissue_sim.progress import task

# Relative durations of the stages of a usual build; only the pace of the progress bar depends on them.
_FRACTION = {"read": 8, "segment": 40, "wall": 6, "balloon": 38, "skeleton": 6, "springs": 2, "report": 25}
_UNITS = ("mm", "cm", "m", "um", "in")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `tissue_sim build`."""
    parser.add_argument("image", nargs="?", metavar="IMAGE", help="CT: a NIfTI, NRRD or MHA file, or a DICOM folder")
    source = parser.add_argument_group("input (IMAGE with a seed, or one of --mask, --surface)")
    source.add_argument(
        "--seed",
        metavar="X,Y,Z",
        help="a point inside the organ: millimetres in the patient frame of the image, LPS (x to the patient's left,"
        " y to the back, z to the head), for every format; Slicer and ITK-SNAP show R,A,S: negate the first two",
    )
    source.add_argument(
        "--seed-voxel", metavar="I,J,K", help="the same as voxel indices, from 0, in the file's axis order"
    )
    source.add_argument("--series", metavar="UID", help="series to read when the DICOM folder holds several")
    source.add_argument("--mask", metavar="FILE", help="start from a segmentation (same formats) instead of a seed")
    source.add_argument(
        "--label",
        metavar="N|NAME",
        help="value, segment number or name of the organ in a --mask with several; LAYER:N if a number occurs in"
        " several layers of a file",
    )
    source.add_argument(
        "--inclusion",
        action="append",
        default=[],
        metavar="N:TIMES",
        help="label N of --mask belongs to the organ and is TIMES times as stiff, such as a tumour; give it once"
        " for each label",
    )
    source.add_argument(
        "--surface", metavar="FILE", help="start from a closed mesh (OBJ, STL, PLY, OFF, GLB, VTK, MSH, TRIAN)"
    )
    source.add_argument("--keep-points", action="store_true", help="keep the points of --surface and their order")
    source.add_argument("--unit", choices=_UNITS, help="length unit of --surface if the format doesn't state it")
    source.add_argument("--length", type=float, metavar="METRES", help="longest side of --surface, instead of a unit")
    source.add_argument(
        "--part", metavar="N", help="part of --mask or --surface to use, 1 is the largest, or its name in a --surface"
    )
    source.add_argument(
        "--merge-parts",
        action="store_true",
        help="join all parts of --mask, or all solids that the parts of --surface enclose",
    )
    organ = parser.add_argument_group("the organ")
    organ.add_argument("--out", default="organ.npz", metavar="FILE", help="organ file to write (default: %(default)s)")
    organ.add_argument(
        "--report",
        nargs="?",
        const="",
        metavar="FILE.html",
        help="write a page with pictures and figures of every stage (default: the organ file's name with .html)",
    )
    organ.add_argument(
        "--name",
        help="name of the organ (default: that of --organ, --label or --part, or the input's file name)",
    )
    organ.add_argument("--points", type=int, default=994, help="points of the balloon surface (default: %(default)s)")
    organ.add_argument("--refine", action="append", default=[], metavar="WHERE", help=REFINE_HELP)
    organ.add_argument(
        "--atoms",
        type=int,
        help=f"medial atoms of the skeleton (default: {MOST_ATOMS}, fewer if they would be closer than {SPARSE:g}"
        " edges of the surface)",
    )
    organ.add_argument(
        "--branches",
        choices=("auto", "none"),
        default="auto",
        help="auto: the skeleton follows real branches of the organ; none: one line (default: %(default)s)",
    )
    organ.add_argument(
        "--interior",
        type=int,
        default=0,
        metavar="N",
        help="further atoms distributed through the organ, along the spokes (default: %(default)s)",
    )
    organ.add_argument(
        "--fixed",
        default="z<0.1",
        metavar="WHICH",
        help="surface nodes that are fixed: 'z<0.1' for the lowest tenth along z (axes x, y, z; < or >), a .npy"
        " file of indices, or none (default: %(default)s)",
    )
    organ.add_argument("--youngs-modulus", type=float, default=10_000.0, metavar="PA", help="Pa (default: %(default)g)")
    organ.add_argument("--poisson-ratio", type=float, default=0.45, metavar="NU", help="default: %(default)g")
    organ.add_argument("--density", type=float, default=1060.0, metavar="KG_M3", help="kg/m^3 (default: %(default)g)")
    add_law(organ)
    _add_stages(parser)


def run(args: argparse.Namespace) -> int:
    """Build the organ that the arguments describe, print what was done, and return 0.

    Raises UserError as the stages do, and for invalid use.
    """
    try:
        return _run(args)
    except ModuleNotFoundError as error:
        raise UserError(f"building organs needs {error.name}; {EXTRA}") from None


def _run(args: argparse.Namespace) -> int:
    started = time.perf_counter()
    source = _source(args)
    out = Path(args.out)
    check_file("--out", out, ".npz", "the organ file")
    report = report_path(args, out)
    _check_counts(args)
    name = args.name or name_of(args.organ, args.label, args.part, stem_of(Path(source)))
    request = Request(
        name=name,
        points=args.points,
        atoms=args.atoms,
        branches=args.branches,
        interior_atoms=args.interior,
        organ=None if args.organ == "any" else args.organ,
        accept=args.accept,
        fixed=args.fixed,
        youngs_modulus=args.youngs_modulus,
        poisson_ratio=args.poisson_ratio,
        density=args.density,
        refinement=parse_refine(args.refine),
        provenance={
            "source": Path(source).name,
            "source_sha256": digest_of(Path(source)),
            **({"inclusions": list(args.inclusion)} if args.inclusion else {}),
            **({"refine": [Path(where).name for where in args.refine]} if args.refine else {}),
        },
    )
    kind, given = _given(args)
    with _under_way(_stages_of(args)) as progress:
        with leaving("no organ was written"):
            organ = with_law(make(kind, source, request, given, progress), args)
        organ.save(out)
        if report:
            from tissue_sim.organ.reporting.page import write_report

            with progress.stage("report"), leaving(f"{out} is written, and its report is not"):
                write_report(progress.record, report, organ_file=out.name)
    n, edge = organ.n_surface, 1e3 * usual_edge(organ)
    print(
        f"{out}: {name}, {organ.volume * 1e6:.1f} mL, {n} points, {len(organ.surface_triangles)} triangles,"
        f" {organ.n_atoms} atoms, {len(organ.fixed)} fixed, {time.perf_counter() - started:.1f} s"
    )
    print(
        f"{out}: resolves spheres with a radius of at least {FINE * edge:.2g} mm (error {FINE_WITHIN:g} % after"
        f" calibration) or {FAIR * edge:.2g} mm ({FAIR_WITHIN:g} %); use more --points for smaller ones"
    )
    from tissue_sim.calibration.coarseness import coarseness  # needs the image libraries

    coarse = coarseness(organ)
    if coarse is not None:
        print(f"warning: too coarse to be calibrated well: {coarse}")
    if report:
        print(f"{report}: report")
    return 0


# options of the segmentation, one for each of its parameters ------------------------------------------


def _add_stages(parser: argparse.ArgumentParser) -> None:
    """Add an option for every field of SegmentationParameters, with its help and unit."""
    group = parser.add_argument_group("segmentation from a seed")
    group.add_argument(
        "--organ",
        default="any",
        metavar="NAME",
        help="kind of organ, so that even a small leak into a neighbour is detected: kidney, liver, spleen, heart,"
        " bladder, prostate, or any (default: %(default)s); it also names the organ",
    )
    group.add_argument(
        "--accept",
        action="store_true",
        help="accept, with a warning, an organ that fails these checks, or whose volume differs from that of its input",
    )
    for item in dataclasses.fields(SegmentationParameters):
        default = f" (default: {item.default:g})" if item.default is not None else ""
        text = item.metadata["help"].replace("%", "%%")
        group.add_argument(
            _option(item.name), type=float, metavar=item.metadata["unit"].upper(), help=f"{text}{default}"
        )


def _option(field: str) -> str:
    return "--" + field.replace("_", "-")


def _parameters(args: argparse.Namespace) -> SegmentationParameters:
    given = {item.name: getattr(args, item.name) for item in dataclasses.fields(SegmentationParameters)}
    return SegmentationParameters(**{name: value for name, value in given.items() if value is not None})


# checks before the work begins ---------------------------------------------------------------------


def _check_counts(args: argparse.Namespace) -> None:
    """Refuse at once what would otherwise be refused after the segmentation."""
    from tissue_sim.organ.interior import check_interior
    from tissue_sim.organ.organ_file import check_law
    from tissue_sim.organ.skeletons.skeleton import check_atoms
    from tissue_sim.organ.surfaces.balloon import check_points
    from tissue_sim.organ.topology import check_tissue

    if not args.keep_points:
        check_points(args.points)
    if args.atoms is not None:
        check_atoms(args.atoms)
    check_tissue(args.youngs_modulus, args.poisson_ratio, args.density)
    check_law("--", **law_of(args))
    check_interior(args.interior)
    parse_inclusions(args.inclusion, args.label)
    if args.refine and args.keep_points:
        raise UserError("--refine adds points, and --keep-points keeps those that there are; choose one")
    if args.refine and args.fixed.strip().endswith(".npy"):
        raise UserError("--fixed FILE.npy names nodes by number, and --refine changes those; use --fixed 'z<0.1'")
    if args.image:
        from tissue_sim.organ.segmenting.anatomy import anatomy_of

        anatomy_of(None if args.organ == "any" else args.organ)
        _parameters(args)
    from_file = args.fixed.strip().endswith(".npy")
    count = np.iinfo(np.int32).max if args.keep_points else args.points
    select_fixed(args.fixed, np.broadcast_to(np.zeros((1, 3)), (count if from_file else 1, 3)))


def _source(args: argparse.Namespace) -> str:
    """Return the one input that was named; refuse none, several, and options that don't belong to it."""
    inputs = (("IMAGE", args.image), ("--mask", args.mask), ("--surface", args.surface))
    given = [(what, path) for what, path in inputs if path]
    if not given:
        raise UserError("nothing to build from; name an IMAGE with --seed, a --mask or a --surface")
    if len(given) > 1:
        raise UserError(f"{' and '.join(what for what, _ in given)} were given; choose one")
    what, path = given[0]
    if args.part and args.merge_parts:
        raise UserError("--part and --merge-parts were given; choose one")
    if what == "--mask" and args.part and not args.part.isdigit():
        raise UserError(f"--part {args.part} is not a number; parts of a mask have no names: 1 is the largest")
    seeded = args.seed or args.seed_voxel
    if what == "IMAGE" and not seeded:
        raise UserError("an image needs a point inside the organ: --seed X,Y,Z or --seed-voxel I,J,K")
    if args.seed and args.seed_voxel:
        raise UserError("--seed and --seed-voxel were given; choose one")
    stages = [] if what == "IMAGE" else [item.name for item in dataclasses.fields(SegmentationParameters)]
    for option, value, owner in (
        ("--seed", seeded, "IMAGE"),
        ("--series", args.series, "IMAGE"),
        ("--label", args.label is not None, "--mask"),
        ("--inclusion", args.inclusion, "--mask"),
        ("--unit", args.unit, "--surface"),
        ("--length", args.length is not None, "--surface"),
        ("--part", args.part and what == "IMAGE", "--mask and --surface"),
        ("--merge-parts", args.merge_parts and what == "IMAGE", "--mask and --surface"),
        ("--keep-points", args.keep_points, "--surface"),
        *((_option(name), getattr(args, name) is not None, "IMAGE") for name in stages),
    ):
        if value and owner != what:
            raise UserError(f"{option} belongs to {owner}, not to {what}")
    return str(path)


def report_path(args: argparse.Namespace, out: Path) -> Path | None:
    """Return the path of the report: None without --report, beside `out` without a name.

    Raises UserError for what couldn't be written after the build.
    """
    if args.report is None:
        return None
    path = Path(args.report) if args.report else out.with_suffix(".html")
    if path.suffix.lower() not in (".html", ".htm"):
        raise UserError(f"--report {path} must end in .html; without a file name, put --report last")
    check_folder(path, "the report")
    for library in ("matplotlib", "jinja2"):
        if importlib.util.find_spec(library) is None:
            raise UserError(f"--report needs {library}; {EXTRA}")
    return path


# the work -----------------------------------------------------------------------------------------


def _stages_of(args: argparse.Namespace) -> list[str]:
    """Return the stages that this input goes through."""
    left_out = {"segment"} if not args.image else set()
    left_out |= {"balloon"} if args.keep_points else set()
    stages = [stage for stage in STAGES if stage not in left_out]
    return [*stages, "report"] if args.report is not None else stages


def _given(args: argparse.Namespace) -> tuple[str, SourceOptions]:
    """Return the kind of the input, and its options as the library takes them."""
    part = int(args.part) if args.part and args.part.isdigit() else args.part
    of_parts: SourceOptions = {"part": part, "merge_parts": args.merge_parts}
    if args.surface:
        return "surface", {"unit": args.unit, "length": args.length, "keep_points": args.keep_points, **of_parts}
    if args.mask:
        return "mask", {"label": args.label, "inclusions": parse_inclusions(args.inclusion, args.label), **of_parts}
    options: SourceOptions = {"series": args.series, "segmentation": asdict(_parameters(args))}
    if args.seed:
        return "image", {**options, "seed": parse_triple("--seed", args.seed)}
    return "image", {**options, "seed_voxel": parse_triple("--seed-voxel", args.seed_voxel)}


@contextmanager
def _under_way(stages: list[str]) -> Iterator[Progress]:
    """Yield the receiver of what the stages report: lines on the standard output, and progress as parts of one task."""
    start = dict(zip(stages, itertools.accumulate((_FRACTION[stage] for stage in stages), initial=0.0), strict=False))
    with task(stages[0], sum(_FRACTION[stage] for stage in stages), "%") as whole:

        def watch(stage: str, done: float) -> None:
            if stage in start:
                whole.name = stage
                whole.reach(max(whole.done, start[stage] + done * _FRACTION[stage]))  # never backwards

        yield Progress(partial(print, flush=True), watch)


def parse_triple(option: str, text: str) -> Floats:
    """Return three finite numbers, (3,), of a text such as `1.5,-20,300`. Raises UserError naming the option."""
    try:
        values = np.array([float(part) for part in text.replace(" ", "").split(",")])
    except ValueError:
        values = np.empty(0)
    if len(values) != 3 or not np.all(np.isfinite(values)):
        raise UserError(f"{option} '{text}' is not three numbers; write them as 1.5,-20,300")
    return values
