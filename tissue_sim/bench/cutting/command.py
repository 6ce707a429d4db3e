"""Benchmark `tissue_sim bench cut`: time of a cut and of the ticks around it, or its error against finite elements."""

from __future__ import annotations

import argparse
import importlib.util
from pathlib import Path

from tissue_sim.bench.arguments import add_priority, add_shared, check_priority
from tissue_sim.bench.cutting import accuracy, node_times, times
from tissue_sim.bench.cutting.cuts import CUTS
from tissue_sim.bench.cutting.organs import kidney, makers
from tissue_sim.bench.cutting.reference import STORED, remake
from tissue_sim.bench.printing import Result, bound_lines, noise_lines
from tissue_sim.bench.timing import in_one_thread
from tissue_sim.errors import UserError
from tissue_sim.json_types import JsonObject
from tissue_sim.organ.shipped import shipped_organ

ORGANS = ("kidney", "slab", "liver")
PEER = (
    "for comparison, Sase, Fukuhara, Tsujita & Konno 2015 (ROBOMECH Journal 2, 17): a time step of blunt dissection",
    "takes less than 20 ms on a graphics processor, for 4,807 nodes and 19,600 elements",
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    add_shared(parser, organ=None, check=True)
    add_priority(parser)
    parser.add_argument(
        "--accuracy", action="store_true", help="compare cuts with finite elements that hold the same cut, not times"
    )
    parser.add_argument("--organs", nargs="+", choices=ORGANS, default=ORGANS, help="which organs to compare")
    parser.add_argument(
        "--data", metavar="FOLDER", help="folder of the organ data, for the liver (default: it is left out)"
    )
    parser.add_argument(
        "--refine",
        action="store_true",
        help="make each organ's surface finer where the cut will be, and calibrate it: some minutes for each cut, once",
    )
    parser.add_argument("--only", metavar="TEXT", help="compare only cuts whose name contains this, such as '20 x 5'")
    parser.add_argument(
        "--remake",
        action="store_true",
        help="first compute the finite elements of the kidney's cuts, or those of --only, and write them where they are"
        " read: ten minutes for each, unless the user's cache has it",
    )


def run(args: argparse.Namespace) -> Result:
    """Measure what the arguments ask for."""
    if not args.accuracy:
        for name, given in (
            ("--data", args.data),
            ("--remake", args.remake),
            ("--organs", args.organs != ORGANS),
            *(("--refine", args.refine), ("--only", args.only)),
        ):
            if given:
                raise UserError(f"{name} needs --accuracy")
        check_priority(args.realtime_priority)
        found = _times(args.realtime_priority)
        return Result(found, _text(found))
    cuts = [cut for cut in CUTS if cut.organ in args.organs and (args.only or "") in cut.name]
    if not cuts:
        raise UserError(f"no cut has --only '{args.only}' in its name: {', '.join(cut.name for cut in CUTS)}")
    if args.remake:
        chosen = [cut for cut in cuts if cut.organ == "kidney"]
        if not chosen:
            raise UserError("--remake is for the kidney's cuts; others are kept in the user's cache")
        remake(kidney(), shipped_organ().parents[2] / STORED, chosen)
    made = makers(Path(args.data) if args.data else None)
    found = accuracy.as_json(*accuracy.measure(made, cuts, refine=args.refine))
    return Result(found, accuracy.text(found))


def _times(priority: int) -> JsonObject:
    """Return the times of cuts, and of a running node's ticks around them."""
    in_node = node_times.measure(priority) if importlib.util.find_spec("rclpy") else []
    found, node = times.as_json(*in_one_thread(times.measure)), node_times.as_json(in_node, priority)
    return found | {"node": node, "bounds": [*node["bounds"], *found["bounds"]]}


def _text(found: JsonObject) -> str:
    """Return the times as tables."""
    parts = [times.text(found), node_times.text(found["node"]), PEER, bound_lines(found["bounds"])]
    return "\n\n".join("\n".join(part) for part in parts) + "\n".join(["", *noise_lines(found["noise"])])
