"""`tissue_sim calibrate`: fit an organ to a finite-element body of its shape, and tell how good it has become."""

from __future__ import annotations

import argparse
import importlib.util
import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

from tqdm import tqdm

from tissue_sim.calibration.calibrate import Calibrated, calibrate
from tissue_sim.calibration.checkpoint import Checkpoint
from tissue_sim.calibration.stiffness import INTERIOR_SHARE, METHODS, Settings
from tissue_sim.calibration.verdict import lines, write_pictures
from tissue_sim.errors import UserError
from tissue_sim.organ.organ import Organ

MEAN, WORST, SHARP = 5.5, 12.0, 15.0  # %, bounds of --check on held-out loads: smooth, smooth, the sharp ones' mean
RELEASE = 15.0  # %
_DEFAULT = Settings()


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("organ", metavar="ORGAN", help="organ file (.npz) with held nodes")
    parser.add_argument("--out", required=True, metavar="ORGAN2", help="organ file (.npz) to write")
    parser.add_argument(
        "--method",
        choices=METHODS,
        default=_DEFAULT.method,
        help="what is fitted: the moduli of every cell between the nodes (the default), or a factor for each group of"
        " springs, as in the paper",
    )
    parser.add_argument(
        "--for",
        dest="aim",
        choices=tuple(INTERIOR_SHARE),
        default=_DEFAULT.aim,
        help="what the cells are for: more interior atoms take more time in every tick, and are off by less"
        f" ({', '.join(f'{aim}: {100 * share:g}' for aim, share in INTERIOR_SHARE.items())} for 100 surface points;"
        f" default: {_DEFAULT.aim})",
    )
    parser.add_argument("--seed", type=int, default=_DEFAULT.seed, help="of the loads that are fitted")
    parser.add_argument(
        "--cases", type=int, default=_DEFAULT.cases, metavar="N", help="loads to fit, three at each place"
    )
    parser.add_argument(
        "--evaluations", type=int, default=_DEFAULT.evaluations, metavar="N", help="evaluations of the misfit"
    )
    parser.add_argument(
        "--interior",
        type=int,
        metavar="N",
        help="interior atoms of the result, which is then built anew (default: as many as --for asks for; those of the"
        " organ for groups)",
    )
    parser.add_argument("--smooth", type=int, default=_DEFAULT.smooth, metavar="N", help="held-out smooth loads")
    parser.add_argument("--sharp", type=int, default=_DEFAULT.sharp, metavar="N", help="held-out sharp loads")
    parser.add_argument("--report", metavar="FOLDER", help="also write pictures of the errors and worst cases there")
    parser.add_argument(
        "--check",
        action="store_true",
        help=f"exit with 1 unless the held-out loads settle, smooth ones"
        f" within {MEAN:g} %% mean and {WORST:g} %% worst, sharp ones within {SHARP:g} %% mean, and the"
        f" release within {RELEASE:g} %%",
    )


def run(args: argparse.Namespace) -> int:
    """Calibrate, write the organ and print the figures; returns 0, or 1 with --check when a bound is missed."""
    settings = _settings(args)
    out = Path(args.out)
    if out.suffix != ".npz":
        raise UserError(f"--out {out} must end in .npz")
    if not out.parent.is_dir():
        raise UserError(f"folder {out.parent} for the organ file does not exist; make it first")
    if args.report and importlib.util.find_spec("matplotlib") is None:
        raise UserError("--report needs matplotlib: pip install 'tissue_sim[calibration]'")
    organ = Organ.load(args.organ)
    started = time.perf_counter()
    folder = out.with_name(f".{out.name}.calibration")
    checkpoint = Checkpoint(folder, {"organ": organ.digest(), "version": _version(), **asdict(settings)})
    if checkpoint.found:
        print(f"going on from {folder}")
    try:
        found = calibrate(organ, settings, checkpoint, Bars())
    except KeyboardInterrupt:
        sys.stderr.write(f"stopped; the same command goes on from {folder}\n")
        raise
    _save(found, out)
    checkpoint.remove()
    for line in lines(found.figures):
        print(line)
    if args.report:
        for path in write_pictures(found, Path(args.report)):
            print(f"{path}: picture")
    print(f"{out}: {found.organ.name}, {time.perf_counter() - started:.0f} s")
    missed = list(_missed(found.figures))
    if args.check:
        for line in missed:
            print(f"missed: {line}")
    return 1 if args.check and missed else 0


def _settings(args: argparse.Namespace) -> Settings:
    """The settings that the arguments name; raises UserError for numbers out of range."""
    for option, least, most in (
        ("seed", 0, 2**31),
        ("cases", 8, 10_000),
        ("evaluations", 1, 10_000),
        ("smooth", 1, 1000),
        ("sharp", 0, 1000),
    ):
        value = getattr(args, option)
        if not least <= value <= most:
            raise UserError(f"--{option.replace('_', '-')} {value} is outside {least}..{most}")
    if args.interior is not None and args.interior < 0:
        raise UserError(f"--interior {args.interior} is negative; use 0 or more")
    names = ("seed", "method", "aim", "cases", "evaluations", "interior", "smooth", "sharp")
    return Settings(**{name: getattr(args, name) for name in names})


def _save(found: Calibrated, out: Path) -> None:
    """Write the organ, whole or not at all."""
    part = out.with_name(f".{out.name}.part")
    found.organ.save(part)
    try:
        os.replace(part, out)
    except OSError as error:
        raise UserError(f"cannot write organ file {out}: {error.strerror}") from None


def _missed(figures: dict[str, Any]) -> Iterator[str]:
    """Bounds that are missed."""
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
            yield f"{found['cases'] - found['settled']} of {found['cases']} loads did not settle"


def _version() -> str:
    import tissue_sim

    return tissue_sim.__version__


class Bars:
    """A bar for each stage on a terminal, and a line when it is done."""

    @contextmanager
    def stage(self, name: str, total: int) -> Iterator[Callable[..., None]]:
        """See calibrate.Progress."""
        started = time.perf_counter()
        last = ""
        # disable=None: tqdm stays silent where standard error is no terminal.
        with tqdm(total=total, desc=name, disable=None, leave=False, dynamic_ncols=True) as bar:

            def done(remark: str = "") -> None:
                nonlocal last
                last = remark or last
                bar.update(1)
                bar.set_postfix_str(last)

            yield done
        seconds = time.perf_counter() - started
        print(f"{name}: {last + ', ' if last else ''}{seconds:.1f} s", flush=True)
