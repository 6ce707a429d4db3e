"""Arguments that benchmarks share: ORGAN, --json FILE, --out FOLDER, --realtime-priority."""

from __future__ import annotations

import argparse
from pathlib import Path

from tissue_sim.errors import UserError
from tissue_sim.outputs import make_folder
from tissue_sim.ros.shared.priority import HIGHEST, is_allowed

DEFAULT_ORGAN = "the calibrated kidney of this package"
AS_BUILT_ORGAN = "the kidney of this package before calibration, with the paper's 48 atoms"


def add_shared(
    parser: argparse.ArgumentParser,
    *,
    organ: str | None = DEFAULT_ORGAN,
    out: str | None = None,
    seconds: float | None = None,
    check: bool = False,
) -> None:
    """Add ORGAN and --json, and further arguments on request.

    organ: description of the default organ, None for no argument ORGAN; out: description of --out, None where there is
    nothing to draw; seconds: default of --seconds, None where the duration can't be chosen; check: whether there are
    bounds, and so --check.
    """
    parser.set_defaults(out=None, check=False)
    if organ is not None:
        parser.add_argument("organ", nargs="?", metavar="ORGAN", help=f"organ file (.npz); default: {organ}")
    parser.add_argument(
        "--json", nargs="?", const="-", metavar="FILE", help="write JSON to a file, or - instead of text"
    )
    if out:
        parser.add_argument("--out", metavar="FOLDER", help=out)
    if seconds:
        parser.add_argument("--seconds", type=float, default=seconds, help="duration of each measurement, s")
    if check:
        parser.add_argument("--check", action="store_true", help="exit with 1 when a bound is not met")


def add_priority(parser: argparse.ArgumentParser) -> None:
    """Add --realtime-priority, of a node and what is measured beside it."""
    parser.add_argument(
        "--realtime-priority",
        type=int,
        default=0,
        metavar="P",
        help=f"real-time priority of the node and of the processes it is compared with, 1 to {HIGHEST}, if the"
        " system allows it (default: none)",
    )


def check_priority(priority: int) -> None:
    """Raise UserError when the system doesn't allow a real-time priority."""
    if not is_allowed(priority):
        raise UserError(f"this user is not allowed to use real-time priority {priority}: see 'ulimit -r'")


def check_shared(args: argparse.Namespace) -> None:
    """Report before the work what would fail after it, and make the folder of --out.

    Raises UserError where the file for JSON is an organ (as in `--json ORGAN`), the folder can't be made, or --seconds
    or --realtime-priority is out of range; ModuleNotFoundError where something is to be drawn without matplotlib.
    """
    if args.json and args.json.endswith(".npz"):
        raise UserError(f"--json {args.json} would overwrite an organ; put ORGAN before --json, or - after it")
    if not 1.0 <= getattr(args, "seconds", 1.0) <= 3600.0:
        raise UserError(f"--seconds {args.seconds:g} is outside 1..3600")
    if not 0 <= getattr(args, "realtime_priority", 0) <= HIGHEST:
        raise UserError(f"--realtime-priority {args.realtime_priority} is outside 0..{HIGHEST}")
    if getattr(args, "out", None):
        import matplotlib  # noqa: F401

        make_folder(Path(args.out))
