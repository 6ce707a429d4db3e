"""Arguments that benchmarks share: ORGAN, --json FILE, --out FOLDER."""

from __future__ import annotations

import argparse
from pathlib import Path

from tissue_sim.errors import UserError

DEFAULT_ORGAN = "the kidney that ships"
AS_BUILT_ORGAN = "the kidney that ships, as built, with the paper's 48 atoms"


def add_shared(parser: argparse.ArgumentParser, *, organ: str = DEFAULT_ORGAN, out: str | None = None) -> None:
    """ORGAN, whose default is told as `organ`, and --json; --out, told as `out`, where there is something to draw."""
    parser.add_argument("organ", nargs="?", metavar="ORGAN", help=f"organ file (.npz); default: {organ}")
    parser.add_argument(
        "--json", nargs="?", const="-", metavar="FILE", help="write JSON to a file, or - instead of text"
    )
    if out:
        parser.add_argument("--out", metavar="FOLDER", help=out)


def check_shared(args: argparse.Namespace) -> None:
    """Say before the work what would fail after it, and make the folder of --out.

    Raises UserError when the file for JSON is an organ (`--json ORGAN` takes it for one) or the folder can't be made,
    ModuleNotFoundError when there is to be drawn without matplotlib.
    """
    if args.json and args.json.endswith(".npz"):
        raise UserError(f"--json {args.json} would write over an organ; put ORGAN before --json, or - after it")
    if getattr(args, "out", None):
        import matplotlib  # noqa: F401

        try:
            Path(args.out).mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise UserError(f"cannot make folder {args.out}: {error.strerror}; name another with --out") from None


def check_seconds(args: argparse.Namespace) -> None:
    """Raises UserError when --seconds, for which something is measured, is out of range."""
    if not 1.0 <= args.seconds <= 3600.0:
        raise UserError(f"--seconds {args.seconds:g} is outside 1..3600")
