"""Command `tissue_sim calibrate`: fit an organ to a finite-element body of its shape, and report the accuracy."""

from __future__ import annotations

import argparse
import importlib.util
import time
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path

from tissue_sim import progress
from tissue_sim.calibration.calibrate import calibrate
from tissue_sim.calibration.calibration_report import lines, write_pictures
from tissue_sim.calibration.checkpoint import Checkpoint
from tissue_sim.calibration.coarseness import accuracy_warning
from tissue_sim.calibration.stiffness import INTERIOR_FRACTION, METHODS, Settings
from tissue_sim.commands.build_refine import parse_refine
from tissue_sim.commands.calibrate_many import (
    add_cluster,
    calibrate_many,
    check_cluster,
    outputs_of,
    write_figures,
    write_whole,
)
from tissue_sim.commands.law_options import add_law, law_of, with_law
from tissue_sim.errors import UserError
from tissue_sim.interrupts import leaving
from tissue_sim.json_types import JsonObject
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.refined import refined
from tissue_sim.outputs import check_file, make_folder
from tissue_sim.version import __version__

MEAN, WORST, SHARP = 5.5, 12.0, 15.0  # %, bounds of --check: smooth loads' mean and worst, sharp ones' mean
RELEASE = 15.0  # %
TIME = (
    "A kidney of 994 points takes two minutes on two idle cores, and another half a minute if kernels have to be"
    " compiled. The time grows with the surface's points and on thin organs, which both need more finite elements,"
    " and with --smooth, --sharp, --cases and --evaluations; it is longer without a second core. A separate process"
    " solves loads during the fit, and both processes do so at the end, with the same result bit for bit as on one"
    " core. Each process keeps the finite elements once, with matrices of at most 0.5 GB."
)
REFINED = (
    "first give the organ's surface more points in some places, where tools will touch or cut it; its shape stays. In"
    " the forms of 'tissue_sim build --refine'; may be given several times"
)
_DEFAULT = Settings()


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.epilog = TIME
    parser.add_argument("organ", nargs="+", metavar="ORGAN", help="organ file (.npz) with fixed nodes; or several")
    parser.add_argument(
        "--out", required=True, metavar="ORGAN2", help="organ file (.npz) to write; a folder for several organs"
    )
    add_cluster(parser)
    parser.add_argument("--json", metavar="FILE", help="JSON file for all figures of several organs")
    parser.add_argument(
        "--method",
        choices=METHODS,
        default=_DEFAULT.method,
        help="fit the moduli of every cell between the nodes, or a factor for each group of springs, as in the paper",
    )
    parser.add_argument(
        "--for",
        dest="aim",
        choices=tuple(INTERIOR_FRACTION),
        default=_DEFAULT.aim,
        help="purpose of the cells: more interior atoms take more time in every tick, and have a smaller error"
        f" ({', '.join(f'{aim}: {100 * fraction:g}' for aim, fraction in INTERIOR_FRACTION.items())} for 100 surface"
        f" points; default: {_DEFAULT.aim})",
    )
    add_law(parser)
    parser.add_argument("--seed", type=int, default=_DEFAULT.seed, help="seed of the loads that are fitted")
    parser.add_argument(
        "--cases", type=int, default=_DEFAULT.cases, metavar="N", help="loads to fit, three at each point"
    )
    parser.add_argument(
        "--evaluations", type=int, default=_DEFAULT.evaluations, metavar="N", help="evaluations of the misfit"
    )
    parser.add_argument(
        "--interior",
        type=int,
        metavar="N",
        help="interior atoms of the result, which are distributed again (default: given by --for; those of the"
        " organ for groups)",
    )
    parser.add_argument(
        "--smooth", type=int, default=_DEFAULT.smooth, metavar="N", help="number of held-out smooth loads"
    )
    parser.add_argument("--sharp", type=int, default=_DEFAULT.sharp, metavar="N", help="number of held-out sharp loads")
    parser.add_argument("--refine", action="append", default=[], metavar="WHERE", help=REFINED)
    parser.add_argument("--report", metavar="FOLDER", help="folder for pictures of the errors and worst cases")
    parser.add_argument(
        "--check",
        action="store_true",
        help=f"exit with 1 unless the held-out loads converge, with errors of smooth loads within {MEAN:g} %% mean"
        f" and {WORST:g} %% worst, of sharp loads within {SHARP:g} %% mean, and of the release within"
        f" {RELEASE:g} %%",
    )


def run(args: argparse.Namespace) -> int:
    """Calibrate, write and print figures; return 0, or 1 when an organ failed or, with --check, a bound was missed."""
    settings = _settings(args)
    out = Path(args.out)
    several = len(args.organ) > 1 or out.is_dir()
    if several or any(option is not None for option in (args.jobs, args.scheduler, args.json)):
        return _run_many(args, settings)
    check_file("--out", out, ".npz", "the organ file")
    if args.report and importlib.util.find_spec("matplotlib") is None:
        raise UserError("--report needs matplotlib: pip install 'tissue_sim[calibration]'")
    with progress.task("reading"):
        organ = Organ.load(args.organ[0])
    if args.refine:
        with progress.task("refining"):
            organ, before = refined(organ, parse_refine(args.refine)), organ.n_surface
        print(f"refined from {before} to {organ.n_surface} points")
    organ = with_law(organ, args)
    with progress.task("looking for coarse places"):
        warning = accuracy_warning(organ)
    if warning:
        print(f"warning: {warning}")
    started = time.perf_counter()
    folder = out.with_name(f".{out.name}.calibration")
    checkpoint = Checkpoint(folder, {"organ": organ.digest(), "version": __version__, **asdict(settings)})
    if checkpoint.found:
        print(f"continuing from {folder}")
    with leaving(f"the same command continues from {folder}"):
        found = calibrate(organ, settings, checkpoint, progress.Stages())
    write_whole(found.organ, out)
    checkpoint.remove()
    for line in lines(found.figures):
        print(line)
    if args.report:
        for path in write_pictures(found, Path(args.report)):
            print(f"{path}: picture")
    print(f"{out}: {found.organ.name}, {time.perf_counter() - started:.0f} s")
    missed = list(_missed(found.figures))
    for line in missed:
        print(f"{'missed' if args.check else 'warning'}: {line}")
    return int(bool(missed and args.check))


def _run_many(args: argparse.Namespace, settings: Settings) -> int:
    """Calibrate several organs into a folder."""
    for name, given in (("--report", args.report), ("--refine", args.refine)):
        if given:
            raise UserError(f"{name} is for a single organ")
    if law_of(args):
        raise UserError("--stiffening and --relaxation are for a single organ; build the others with them")
    check_cluster(args)
    folder = Path(args.out)
    if folder.suffix == ".npz":
        raise UserError(f"--out {folder} must be a folder for several organs, or with --jobs, --scheduler or --json")
    if args.json:
        check_file("--json", Path(args.json), ".json", "the figures")
    make_folder(folder)
    organs = [Path(name) for name in args.organ]
    outputs = outputs_of(organs, folder)
    with leaving(f"organs that are ready stay in {folder}, and the same command continues with the others"):
        found = calibrate_many(organs, outputs, settings, args.jobs or 1, args.scheduler)
    if args.json:
        write_figures(found, Path(args.json))
    failed = [name for name, figures in found.items() if isinstance(figures, str)]
    print(f"{folder}: {len(found) - len(failed)} organs calibrated, {len(failed)} not")
    missed = [
        f"{name}: {line}"
        for name, figures in found.items()
        if not isinstance(figures, str)
        for line in _missed(figures)
    ]
    for line in missed:
        print(f"{'missed' if args.check else 'warning'}: {line}")
    return int(bool(failed or (missed and args.check)))


def _settings(args: argparse.Namespace) -> Settings:
    """Return the settings that the arguments name; raises UserError for numbers out of range."""
    names = ("seed", "method", "aim", "cases", "evaluations", "interior", "smooth", "sharp")
    try:
        return Settings(**{name: getattr(args, name) for name in names})
    except UserError as error:
        raise UserError(f"--{error}") from None


def _missed(figures: JsonObject) -> Iterator[str]:
    """Yield the bounds that are missed."""
    held_out = figures["held_out"]
    smooth, sharp = held_out["smooth"], held_out.get("sharp")
    for name, value, bound in (
        ("smooth loads' mean", smooth["mean_percent"], MEAN),
        ("smooth loads' worst", smooth["worst_percent"], WORST),
        ("sharp loads' mean", sharp["mean_percent"] if sharp else 0.0, SHARP),
        ("release", figures["motion"]["release_percent"], RELEASE),
    ):
        if value > bound:
            yield f"{name} {value:.2f} %, bound {bound:g} %"
    for found in held_out.values():
        if found["settled"] < found["cases"]:
            yield f"{found['cases'] - found['settled']} of {found['cases']} loads did not converge"
