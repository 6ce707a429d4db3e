"""`tissue_sim info`: what an organ file holds, for people or as JSON."""

from __future__ import annotations

import argparse
import json

from tissue_sim.organ.organ import Organ
from tissue_sim.organ.reporting.description import describe, file_header, text_lines


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("organ", metavar="ORGAN", help="organ file (.npz)")
    parser.add_argument("--json", action="store_true", help="print one JSON object instead of text")


def run(args: argparse.Namespace) -> int:
    """Print the organ; returns 0. Raises UserError for a file that is missing, damaged or no organ."""
    organ = Organ.load(args.organ)
    found = describe(organ) | file_header(args.organ)
    if args.json:
        print(json.dumps(found, indent=2, ensure_ascii=False))
    else:
        for line in text_lines(found):
            print(line)
    return 0
