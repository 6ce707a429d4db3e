"""`tissue_sim info`: what an organ file or a scene holds, for people or as JSON."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from tissue_sim.organ.organ import Organ
from tissue_sim.organ.reporting.description import describe, file_header, text_lines


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("file", metavar="FILE", help="organ file (.npz), or a scene of several (.yaml)")
    parser.add_argument("--json", action="store_true", help="print one JSON object instead of text")


def run(args: argparse.Namespace) -> int:
    """Print the organ or the scene; returns 0. Raises UserError for a file that is missing, damaged or neither."""
    if Path(args.file).suffix.lower() in (".yaml", ".yml"):
        from tissue_sim.commands.info_scene import describe_scene, scene_lines

        found = describe_scene(Path(args.file))
        lines = scene_lines(found)
    else:
        found = describe(Organ.load(args.file)) | file_header(args.file)
        lines = list(text_lines(found))
    print(json.dumps(found, indent=2, ensure_ascii=False) if args.json else "\n".join(lines))
    return 0
