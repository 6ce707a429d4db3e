"""Command `tissue_sim replay`: run recorded bags again, tick by tick and without DDS, and compare."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from tissue_sim import progress
from tissue_sim.errors import UserError
from tissue_sim.interrupts import leaving
from tissue_sim.organ.organ import Organ
from tissue_sim.ros.bags import recovery
from tissue_sim.ros.bags.comparison import Comparison
from tissue_sim.ros.bags.junit import write_junit
from tissue_sim.ros.bags.outcome import NOTHING, Asked, Outcome, replay_bag, replay_live
from tissue_sim.ros.bags.plotting import picture_path, write_picture
from tissue_sim.ros.shared import client


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument(
        "bags", metavar="BAG", nargs="+", help="folder of a recorded bag; several bags are printed as a table"
    )
    parser.add_argument("--organ", metavar="ORGAN", help="replay with this organ instead of the recorded one")
    parser.add_argument(
        "--against",
        metavar="BAG2",
        help="compare with another recording of the same inputs, at the same ticks after the same pose",
    )
    parser.add_argument("--force-tolerance", type=float, default=1e-6, help="largest deviation of a wrench, N and N m")
    parser.add_argument("--position-tolerance", type=float, default=1e-6, help="largest deviation of a position, m")
    parser.add_argument("--junit", metavar="FILE", help="write the result as JUnit XML, a test case for each quantity")
    parser.add_argument(
        "--plot",
        metavar="FILE|FOLDER",
        help="write a picture (.png): each tool's force, and the deviations of force and position, over time",
    )
    live = parser.add_argument_group("a running node")
    live.add_argument(
        "--live",
        action="store_true",
        help="also send the inputs to a running node, over DDS with /clock, and compare its output with the replay;"
        " start it with use_sim_time:=true",
    )
    live.add_argument("--node", type=client.node_name, default="tissue_sim", help="name of the node")
    live.add_argument("--live-force-tolerance", type=float, default=0.1, help="force tolerance of the node, N and N m")
    live.add_argument("--live-position-tolerance", type=float, default=1e-4, help="position tolerance of the node, m")


def run(args: argparse.Namespace) -> int:
    """Replay bags; return 0 when all repeat within the tolerances, else 1."""
    paths = [Path(given) for given in args.bags]
    if len(paths) > 1 and args.against:
        raise UserError("--against needs exactly one BAG")
    if len(paths) > 1 and args.live:
        raise UserError("--live needs exactly one BAG")
    if len(paths) > 1 and args.plot and args.plot.lower().endswith(".png"):
        raise UserError("--plot must be a folder for several bags")
    for path in [*paths, *([Path(args.against)] if args.against else [])]:
        if recovery.is_interrupted(path):
            with progress.task(f"completing {path.name}"):
                line = recovery.complete(path)
            print(line, flush=True)
    pictures = [picture_path(args.plot, path) for path in paths] if args.plot else []
    organ = Organ.load(args.organ) if args.organ else None
    asked = Asked(args.force_tolerance, args.position_tolerance, organ, Path(args.against) if args.against else None)
    outcomes = []
    columns = Columns(paths)
    if len(paths) > 1:
        print(columns.head, flush=True)
    for index, path in enumerate(paths):
        of_all = f" ({index + 1} of {len(paths)})" if len(paths) > 1 else ""
        with leaving(f"{index} of {len(paths)} bags were compared"), progress.task(f"{path.resolve().name}{of_all}"):
            outcome = replay_bag(path, asked, f"{path}: " if len(paths) > 1 else "")
        outcomes.append(outcome)
        print(columns.row(outcome) if len(paths) > 1 else "\n".join(report_lines(outcome)), flush=True)
        if pictures:
            write_picture(pictures[index], outcome)
            print(f"{pictures[index]}: picture")
    if args.live:
        tolerances = Asked(args.live_force_tolerance, args.live_position_tolerance, organ)
        with progress.task(f"{paths[0].resolve().name} on /{args.node}"):
            outcomes.append(replay_live(paths[0], tolerances, args.node))
        print("\n".join(report_lines(outcomes[-1])), flush=True)
    if args.junit:
        write_junit(Path(args.junit), outcomes)
    return 0 if all(outcome.comparison.passes for outcome in outcomes) else 1


def report_lines(outcome: Outcome) -> list[str]:
    """Return the lines about the result of a bag."""
    replayed, found = outcome.replayed, outcome.comparison
    lines = [
        f"{outcome.name}: {replayed.ticks} ticks, {replayed.inputs} inputs, {replayed.contact_sets} contact sets;"
        f" compared {found.wrenches} wrenches and {found.surfaces} surfaces"
    ]
    if not found.is_empty_comparison:
        lines.append(f"largest deviation: {', '.join(map(str, found.quantities))}")
    return [*lines, verdict(found, outcome.rate)]


def verdict(found: Comparison, rate: float) -> str:
    """Return a line that says whether a bag repeats, and if not from when on; rate: ticks a second."""
    if found.is_empty_comparison:
        return f"FAILED: {NOTHING}; record for longer than a second, with tools moving"
    if found.passes:
        return "repeats"
    first = found.first_beyond
    what = ", ".join(f"{one.what} {one.tolerance:g} {one.unit}" for one in found.quantities if one.first_beyond >= 0)
    return f"FAILED: deviation above {what}, from tick {first} on ({first / rate:.3f} s)"


class Columns:
    """A table with a row for each bag."""

    def __init__(self, paths: Sequence[Path]) -> None:
        self._width = max(len("bag"), *(len(str(path)) for path in paths))
        names = ("ticks", "wrenches", "surfaces", "force (N)", "torque (N m)", "position (m)")
        self.head = f"{'bag':<{self._width}}" + "".join(f"  {name:>12}" for name in names)

    def row(self, outcome: Outcome) -> str:
        """Return the row of a bag's result."""
        found = outcome.comparison
        counts = (outcome.replayed.ticks, found.wrenches, found.surfaces)
        numbers = "".join(f"  {count:>12}" for count in counts)
        numbers += "".join(f"  {one.largest:>12.3g}" for one in found.quantities)
        state = "ok" if found.passes else verdict(found, outcome.rate)
        return f"{outcome.name:<{self._width}}{numbers}  {state}"
