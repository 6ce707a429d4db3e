"""Build the kidney of this package before calibration, or the one with a tumour.

`python -m tissue_sim.commands.build_shipped`; `make organ` then calibrates them.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from tissue_sim.errors import UserError
from tissue_sim.organ.build_record import Progress
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.shipped_kidney import KIDNEY, build_default_kidney, with_tumour
from tissue_sim.unexpected_errors import catch_all


def main(argv: list[str] | None = None) -> int:
    """Write the kidney and return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m tissue_sim.commands.build_shipped", description=__doc__)
    parser.add_argument("--out", type=Path, default=KIDNEY, help="organ file to write (default: %(default)s)")
    parser.add_argument("--report", type=Path, metavar="FILE.html", help="also write a page on how it was built")
    parser.add_argument("--tumour-in", type=Path, metavar="ORGAN", help="instead, add a tumour to this kidney")
    args = parser.parse_args(argv)
    out, progress = args.out, Progress(print)
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        organ = with_tumour(Organ.load(args.tumour_in)) if args.tumour_in else build_default_kidney(progress)
        organ.save(out)
        if args.report and not args.tumour_in:
            from tissue_sim.organ.reporting.page import write_report

            write_report(progress.record, args.report, organ_file=out.name)
    except (UserError, OSError) as error:
        print(f"build_shipped: error: {error}", file=sys.stderr)
        return 2
    print(f"{out}: {organ.volume * 1e6:.1f} mL, {organ.n_surface} points, {organ.n_atoms} atoms")
    return 0


if __name__ == "__main__":
    catch_all("build_shipped", "no organ was written")
    sys.exit(main())
