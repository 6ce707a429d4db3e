"""Command `tissue_sim info`: the content of an organ file or a scene, as text or as JSON."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from tissue_sim.errors import UserError
from tissue_sim.json_types import JsonObject
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.reporting.description import describe, file_header, text_lines
from tissue_sim.organ.tool_resolution import (
    CUT_EDGES,
    FAIR,
    FAIR_WITHIN,
    FINE,
    FINE_WITHIN,
    mean_edge,
    points_for,
)

LARGEST = 0.5  # m, radius of a tool


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.add_argument("file", metavar="FILE", help="organ file (.npz), or a scene of several (.yaml)")
    parser.add_argument(
        "--ball",
        type=float,
        metavar="METRES",
        help="also print how many surface points (build --points) resolve a sphere of this radius",
    )
    parser.add_argument(
        "--cut",
        type=float,
        metavar="METRES",
        help="also print which edges of the surface resolve a cut of this depth, and what gives them",
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object instead of text")


def run(args: argparse.Namespace) -> int:
    """Print the organ or the scene; return 0. Raises UserError for a file that is missing, damaged or neither."""
    if args.ball is not None and not 0.0 < args.ball <= LARGEST:
        raise UserError(f"--ball {args.ball:g} is outside 0..{LARGEST:g} m")
    if args.cut is not None and not 0.0 < args.cut <= LARGEST:
        raise UserError(f"--cut {args.cut:g} is outside 0..{LARGEST:g} m")
    if Path(args.file).suffix.lower() in (".yaml", ".yml"):
        from tissue_sim.commands.info_scene import describe_scene, scene_lines

        if args.ball is not None:
            raise UserError("--ball is for a single organ; name an organ's file (.npz)")
        if args.cut is not None:
            raise UserError("--cut is for a single organ; name an organ's file (.npz)")
        found = describe_scene(Path(args.file))
        lines = scene_lines(found)
    else:
        organ = Organ.load(args.file)
        found = describe(organ) | file_header(args.file)
        if args.ball is not None:
            found["points_for_ball"] = {
                "radius_mm": 1e3 * args.ball,
                f"within_{FINE_WITHIN:g}_percent": points_for(organ, args.ball, FINE),
                f"within_{FAIR_WITHIN:g}_percent": points_for(organ, args.ball, FAIR),
            }
        if args.cut is not None:
            found["points_for_cut"] = _for_cut(organ, args.cut)
        lines = list(text_lines(found))
    print(json.dumps(found, indent=2, ensure_ascii=False) if args.json else "\n".join(lines))
    return 0


def _for_cut(organ: Organ, depth: float) -> JsonObject:
    """Return what a cut of a depth, m, needs: edges there, or so many points everywhere."""
    edge = depth / CUT_EDGES
    return {
        "depth_mm": 1e3 * depth,
        "edge_mm": 1e3 * edge,
        "points_everywhere": points_for(organ, depth, CUT_EDGES),
        "resolved_by": "nothing more"
        if mean_edge(organ) <= edge
        else f"tissue_sim calibrate {organ.name}.npz --refine=X,Y,Z/X,Y,Z:RADIUS:{1e3 * edge:.3g} --out FINER.npz",
    }
